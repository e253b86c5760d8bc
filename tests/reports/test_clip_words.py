"""The words of a clip's page fit the mechanism."""

from keycld.reports import clip_sections


def test_a_cart_on_a_spring_has_no_links_and_no_gravity():
    """It has a keypoint, and a constant force that may be the rest position of its spring."""
    caption = clip_sections.caption({"given": 10, "links": []})
    assert "White: the keypoints as observed" in caption
    assert "keypoints as predicted from the first 10 frames" in caption and "links" not in caption
    cart = {"constants": {"period_1": {}}, "forces": ["springs", "viscous"]}
    forces = clip_sections.acting(cart)
    assert forces.startswith("a constant force (gravity, or") and forces.endswith(", springs, viscous")


def test_a_pendulum_has_both():
    assert "links as observed" in clip_sections.caption({"given": 10, "links": [{"keypoints": ["ball"]}]})
    pendulum = {"constants": {"gravity": {}, "gravity_direction": {}}, "forces": ["viscous"]}
    assert clip_sections.acting(pendulum) == "gravity, viscous"


def test_the_constants_of_pieces_are_said_to_be_so():
    physics = {"fps": 30.0, "measured_on": {"pieces": 4, "frames": 27, "whole": False}}
    said = "The constants were measured on 4 pieces of 27 frames: no motion of the law follows the whole recordings."
    assert clip_sections.about(physics).endswith(said)
    physics["measured_on"] = {"pieces": 1, "frames": 110, "whole": True}
    assert "pieces" not in clip_sections.about(physics) and "30 frames a second" in clip_sections.about(physics)
    physics["changes"] = ["a clock is painted over", "the exposure varies by 2.0%; it is evened out"]
    said = " In the video, a clock is painted over; the exposure varies by 2.0%; it is evened out."
    assert clip_sections.about(physics).endswith(said)
