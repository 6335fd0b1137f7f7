"""The suite: what a BTF is, what a codec must do, how it is measured, run, stored and compared."""
