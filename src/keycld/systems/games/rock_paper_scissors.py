"""Rock, paper, scissors: the set `games/rock_paper_scissors`."""

from keycld.systems.games.base import AbstractGame
from keycld.systems.registry import register


@register
class RockPaperScissors(AbstractGame):
    """ẋᵢ = xᵢ (yᵢ₋₁ − yᵢ₊₁ − w), ẏⱼ = yⱼ (xⱼ₋₁ − xⱼ₊₁ + w), indices modulo 3, w = Σ xᵢ (yᵢ₋₁ − yᵢ₊₁).

    Orbits around (⅓, ⅓, ⅓), (⅓, ⅓, ⅓), with period 2π√3 (109 frames) near the centre; Σ ln xᵢ + Σ ln yⱼ is constant.
    State: the strategies of both players. The picture shows the nine joint probabilities as grey blocks of 11, 11 and
    10 pixels. Source: "Which priors matter?" (arXiv 2111.05458), section 4.2, eq. (4) and appendix A.1.2.
    """

    name = "games/rock_paper_scissors"
    state_names = ("x_1", "x_2", "x_3", "y_1", "y_2", "y_3")
    units = ("1",) * 6
    payoff = ((0.0, -1.0, 1.0), (1.0, 0.0, -1.0), (-1.0, 1.0, 0.0))
