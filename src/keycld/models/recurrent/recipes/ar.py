"""AR: its presets."""

import dataclasses

from keycld.models.recurrent.config import RecurrentConfig
from keycld.models.registry import register_model, register_preset

register_model("ar", family="recurrent", title="an autoregressive recurrent network, without physics")


@register_preset("released", "ar")
@dataclasses.dataclass(frozen=True)
class ReleasedAR(RecurrentConfig):
    """AR as the released code of "Which priors matter?" configures it: five recurrent cells.

    128 windows of 60 frames a step; 500,000 steps need a GPU.
    """


@register_preset("paper", "ar")
@dataclasses.dataclass(frozen=True)
class PaperAR(RecurrentConfig):
    """AR as the text of "Which priors matter?" has it: four recurrent cells and another learning rate."""

    layers: int = 4
    """Recurrent cells, one after the other."""
    rate: float = 5e-4
    """Learning rate of Adam."""


@register_preset("fast", "ar")
@dataclasses.dataclass(frozen=True)
class FastAR(RecurrentConfig):
    """AR with what our recipe of the latent models changes: a small decoder, few rendered frames, small batches."""

    cell: str = "lstm"
    """Kind of the recurrent cells: `vanilla`, `lstm` or `gru`."""
    taper: bool = True
    """Whether the decoder halves its channels each time it doubles the picture: a sixth of the work."""
    rendered: int = 8
    """Random predicted frames of each window that a step renders and compares; 0: all of them."""
    rate: float = 5e-4
    """Learning rate of Adam."""
    batch: int = 16
    """Windows a step."""
    steps: int = 2_000
    """Optimiser steps."""
