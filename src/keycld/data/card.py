"""The README.md of a data set."""
from pathlib import Path
def write_card(folder, system):
    pass
