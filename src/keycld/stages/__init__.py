"""Stages of a training as data: sampler, loss, trainable groups, optimiser, schedule."""

from keycld.stages.losses import AbstractLoss as AbstractLoss
from keycld.stages.losses import AbstractStatefulLoss as AbstractStatefulLoss
from keycld.stages.losses import Terms as Terms
from keycld.stages.optimisers import adam as adam
from keycld.stages.optimisers import forgetful as forgetful
from keycld.stages.optimisers import muon as muon
from keycld.stages.optimisers import packed as packed
from keycld.stages.optimisers import warmup_cosine as warmup_cosine
from keycld.stages.stage import Group as Group
from keycld.stages.stage import Rule as Rule
from keycld.stages.stage import Stage as Stage
from keycld.stages.stage import part as part
from keycld.stages.stage import whole as whole

__all__ = [
    "AbstractLoss",
    "AbstractStatefulLoss",
    "Group",
    "Rule",
    "Stage",
    "Terms",
    "adam",
    "forgetful",
    "muon",
    "packed",
    "part",
    "warmup_cosine",
    "whole",
]
