"""The control laws, one file each; see `keycld.control.registry`."""
