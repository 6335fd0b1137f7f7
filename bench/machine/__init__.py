"""What computes: devices, processors and their threads."""
