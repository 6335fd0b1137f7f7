"""What is typed or read is checked here: errors that name what is wrong, and settings of stated types."""
