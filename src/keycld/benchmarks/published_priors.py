"""Scores that "Which priors matter?" reports (arXiv 2111.05458, Tables 1, 5 and 6), to print next to ours.

Best of 4 to 16 variants for each model and set, one training each; means over 20 trajectories (Table 1).
"""

from typing import NamedTuple

PRIORS_TITLES = {
    "hgn": "HGN",
    "lgn": "LGN",
    "ode": "ODE",
    "ode-tr": "ODE[TR]",
    "rgn-res": "RGN Res",
    "rgn": "RGN",
    "ar": "AR",
}
"""Name and title of each model, in the order of the tables' columns."""

Scores = dict[str, dict[str, float]]


def _table(text: str) -> Scores:
    """Read lines of a set and its numbers in the order of `PRIORS_TITLES`; those that are N/A are left out."""
    lines = (line.split() for line in text.strip().splitlines())
    return {
        name: {model: float(word) for model, word in zip(PRIORS_TITLES, words, strict=False) if word != "N/A"}
        for name, *words in lines
    }


FORWARD = _table(
    """
    toy/mass_spring  1.00  1.00  1.00  1.00  1.00  0.59  0.20
    toy/mass_spring_colors  0.52  0.00  0.52  N/A  0.56  0.25  0.07
    toy/mass_spring_colors_friction  0.41  0.00  0.98  0.26  0.94  0.21  0.15
    toy/pendulum  0.11  0.15  0.26  0.45  0.13  0.00  0.00
    toy/pendulum_colors  0.08  0.10  0.10  0.12  0.10  0.05  0.00
    toy/pendulum_colors_friction  0.13  0.13  0.16  0.30  0.19  N/A  0.00
    toy/double_pendulum  0.13  0.16  0.18  0.20  0.19  0.10  0.00
    toy/double_pendulum_colors  0.15  0.12  0.15  0.16  0.13  0.15  0.15
    toy/double_pendulum_colors_friction  0.11  0.09  0.20  0.17  0.18  0.01  0.01
    toy/two_body  0.29  0.34  1.00  0.99  0.98  0.29  0.69
    toy/two_body_colors  0.21  0.25  0.23  0.24  0.24  0.19  0.15
    room/spiral  0.04  0.00  0.41  0.46  0.40  N/A  0.00
    room/circle  0.07  0.08  0.32  0.35  0.38  N/A  0.00
    md/lj_4  0.18  0.19  0.28  0.26  0.30  0.00  0.04
    md/lj_16  0.00  0.00  0.00  0.00  0.00  0.00  0.01
    games/matching_pennies  0.85  0.85  0.54  0.76  0.40  0.55  0.20
    games/rock_paper_scissors  0.10  0.59  0.35  0.35  0.24  0.10  0.04
    """
)
"""Table 1: forward VPT, a part of the extrapolated frames, mean over 20 trajectories."""

BACKWARD = _table(
    """
    toy/mass_spring  1.00  1.00  0.00  0.91
    toy/mass_spring_colors  0.39  0.00  0.00  N/A
    toy/mass_spring_colors_friction  0.13  0.00  0.00  0.34
    toy/pendulum  0.03  0.15  0.00  0.56
    toy/pendulum_colors  0.01  0.08  0.00  0.10
    toy/pendulum_colors_friction  0.03  0.27  0.00  0.35
    toy/double_pendulum  0.01  0.17  0.00  0.15
    toy/double_pendulum_colors  0.15  0.01  0.00  0.26
    toy/double_pendulum_colors_friction  0.04  0.56  0.00  0.42
    toy/two_body  0.02  0.06  0.00  0.94
    toy/two_body_colors  0.06  0.34  0.00  0.51
    room/spiral  0.00  0.00  0.04  0.45
    room/circle  0.00  0.08  0.04  0.34
    md/lj_4  0.01  0.23  0.06  0.28
    md/lj_16  0.00  0.00  0.00  0.00
    games/matching_pennies  0.86  0.76  0.00  0.83
    games/rock_paper_scissors  0.01  0.67  0.00  0.36
    """
)
"""Table 1: backward VPT; of the four models that run backward."""

RECONSTRUCTION = _table(
    """
    toy/mass_spring  0.05  0.01  0.19  0.17  0.18  0.37  0.35
    toy/mass_spring_colors  1.11  5452.37  1.16  N/A  1.52  159.90  123.00
    toy/mass_spring_colors_friction  1.00  5066.14  1.20  2.11  1.23  5.44  159.51
    toy/pendulum  1.97  1.07  1.44  2.78  2.33  96.70  151.71
    toy/pendulum_colors  25.85  24.66  22.91  29.46  23.08  45.93  240.88
    toy/pendulum_colors_friction  14.27  16.86  16.05  15.09  15.99  N/A  255.36
    toy/double_pendulum  27.39  24.10  20.52  20.88  19.40  56.34  228.03
    toy/double_pendulum_colors  100.15  51.95  53.66  54.61  58.82  100.15  100.16
    toy/double_pendulum_colors_friction  22.57  20.92  26.90  21.95  25.55  93.74  99.93
    toy/two_body  0.21  0.02  0.33  0.25  0.28  36.73  0.46
    toy/two_body_colors  10.64  1.23  2.20  2.30  1.86  24.70  29.35
    room/spiral  106.81  2778.62  56.33  64.30  47.23  N/A  1004.83
    room/circle  121.84  193.02  73.22  87.37  65.35  N/A  309.47
    md/lj_4  55.50  52.26  19.05  28.41  21.93  295.19  342.88
    md/lj_16  380.63  350.52  199.89  221.97  199.42  580.16  524.78
    games/matching_pennies  2.09  1.98  2.42  2.22  2.32  3.65  28.07
    games/rock_paper_scissors  5.13  4.78  5.71  5.77  5.67  13.74  8.08
    """
)
"""Table 5: normalised error of the training length, on test data, times 10⁷/3072."""

EXTRAPOLATION = _table(
    """
    toy/mass_spring  0.07  0.02  0.24  0.24  0.25  0.77  0.51
    toy/mass_spring_colors  2.28  5452.37  2.19  N/A  2.81  159.90  209.82
    toy/mass_spring_colors_friction  2.91  5066.14  1.67  23.00  1.75  52.84  159.34
    toy/pendulum  27.35  16.40  43.11  13.00  50.99  330.10  383.27
    toy/pendulum_colors  104.83  80.73  67.85  76.68  66.77  184.12  390.78
    toy/pendulum_colors_friction  106.10  50.51  42.24  37.03  44.87  N/A  390.77
    toy/double_pendulum  175.64  123.75  108.71  111.95  105.92  178.37  386.67
    toy/double_pendulum_colors  100.16  84.74  84.45  85.23  86.10  100.15  100.16
    toy/double_pendulum_colors_friction  44.54  41.75  44.94  40.22  43.70  93.45  527.19
    toy/two_body  18.00  2.39  0.82  0.74  0.59  102.51  3.00
    toy/two_body_colors  49.03  17.51  17.12  15.28  15.24  75.11  128.58
    room/spiral  286.43  2786.75  62.11  69.46  57.62  N/A  1003.47
    room/circle  151.06  198.48  79.56  91.04  72.19  N/A  803.05
    md/lj_4  219.52  154.30  179.82  134.13  144.22  295.19  500.96
    md/lj_16  459.35  481.14  372.45  391.89  367.19  580.18  800.18
    games/matching_pennies  12.18  10.47  12.62  11.57  11.23  23.02  116.65
    games/rock_paper_scissors  223.96  34.70  37.54  37.11  37.97  120.44  99.11
    """
)
"""Table 6: normalised error of the 60 frames after it, times 10⁷/3072."""


class Published(NamedTuple):
    """A table of the paper.

    Attributes:
        scores: by set and model.
        ranks: its last line, the average rank of each model over the sets.
        larger: whether a larger score is better.
    """

    scores: Scores
    ranks: dict[str, float]
    larger: bool


def _ranks(*numbers: float) -> dict[str, float]:
    return dict(zip(PRIORS_TITLES, numbers, strict=False))


PUBLISHED = {
    "forward": Published(FORWARD, _ranks(4.47, 4.18, 2.88, 2.47, 3.0, 5.65, 5.65), True),
    "backward": Published(BACKWARD, _ranks(2.59, 2.12, 3.47, 1.41), True),
    "reconstruction": Published(RECONSTRUCTION, _ranks(3.24, 3.06, 2.88, 3.24, 2.71, 5.18, 6.29), False),
    "extrapolation": Published(EXTRAPOLATION, _ranks(4.35, 3.59, 2.71, 2.29, 2.35, 5.0, 6.29), False),
}
"""The four tables by the name of what they score."""
