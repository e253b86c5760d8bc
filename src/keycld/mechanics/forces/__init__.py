"""Terms of the potential energy and of the dissipation function, one file a kind."""
