"""Two-player games with replicator dynamics, shown as their joint strategy."""
