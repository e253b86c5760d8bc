"""Scores that the paper reports, to print next to ours."""

from collections.abc import Mapping
from typing import Any

PAPER_VPT: dict[str, dict[str, float]] = {
    "pendulum": {"KeyCLD": 0.38, "KeyCLD-NC": 0.20, "NODE2": 0.12, "FC": 0.00},
    "cartpole": {"KeyCLD": 1.00, "KeyCLD-NC": 0.48, "NODE2": 0.26, "FC": 0.10},
    "acrobot": {"KeyCLD": 1.00, "KeyCLD-NC": 0.50, "NODE2": 0.44, "FC": 0.00},
}
"""VPT as a fraction of 50 frames on 20 validation recordings, two frames given (arXiv v1, Table 1)."""


def published_vpt(scores: Mapping[str, Any]) -> dict[str, float]:
    """Return the paper's VPT by model where it is about the same: 50 frames of its systems, the first two given."""
    protocol = scores["protocol"]
    same = (
        (protocol["horizon"], protocol["given"], protocol.get("start", 0)) == (50, 2, 0)
        and scores["metric"] == "squared"
        and scores["direction"] == "forward"
    )
    return PAPER_VPT.get(scores["system"], {}) if same else {}
