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
    """AR for a CPU: lighter convolutions, few rendered frames, small batches and two cells that learn at once.

    Measured on `toy/mass_spring`, the explained share of the variance of next frames: two vanilla cells 0.96 after 250
    steps, five 0.79 (at a third of the rate), two of LSTM 0.91 after 400. Five of LSTM, at a third of the rate, were no
    better than the mean picture after 2,000.
    """

    layers: int = 2
    """Recurrent cells, one after the other."""
    channels: int = 32
    """Channels of the convolutions."""
    taper: bool = True
    """Whether the decoder halves its channels each time it doubles the picture: a sixth of the work."""
    window: int = 20
    """Frames of a training window; shorter trajectories are used whole."""
    rendered: int = 8
    """Random predicted frames of each window that a step renders and compares; 0: all of them."""
    rate: float = 1.5e-3
    """Learning rate of Adam."""
    batch: int = 16
    """Windows a step."""
    steps: int = 2_000
    """Optimiser steps."""
