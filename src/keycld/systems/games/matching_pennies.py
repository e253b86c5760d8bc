"""Matching pennies: the set `games/matching_pennies`."""

from keycld.systems.games.base import AbstractGame
from keycld.systems.registry import register


@register
class MatchingPennies(AbstractGame):
    """ȧ = 2a(1−a)(2b−1), ḃ = −2b(1−b)(2a−1) for the shares a and b of heads: closed orbits around (½, ½).

    Period 2π (63 frames) near the centre, longer outside; ln a(1−a) + ln b(1−b) is constant. State: both players'
    strategies (a, 1−a, b, 1−b). The picture shows the four joint probabilities as grey squares and holds the whole
    state. Source: "Which priors matter?" (arXiv 2111.05458), section 4.2, eq. (4) and appendix A.1.2.
    """

    name = "games/matching_pennies"
    state_names = ("x_1", "x_2", "y_1", "y_2")
    units = ("1",) * 4
    payoff = ((1.0, -1.0), (-1.0, 1.0))
