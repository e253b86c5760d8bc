"""Scores that the paper reports, to print beside ours."""

PAPER_VPT: dict[str, dict[str, float]] = {
    "pendulum": {"KeyCLD": 0.38, "KeyCLD-NC": 0.20, "NODE2": 0.12, "FC": 0.00},
    "cartpole": {"KeyCLD": 1.00, "KeyCLD-NC": 0.48, "NODE2": 0.26, "FC": 0.10},
    "acrobot": {"KeyCLD": 1.00, "KeyCLD-NC": 0.50, "NODE2": 0.44, "FC": 0.00},
}
"""VPT as a fraction of 50 frames on 20 validation runs, two frames given (arXiv v1, Table 1)."""
