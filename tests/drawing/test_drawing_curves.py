import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from keycld.drawing import (
    INK,
    Curve,
    Limit,
    curves_figure,
    figure_svg,
    histogram_figure,
    map_figure,
    panels_figure,
    save_figure,
    strip_figure,
)

X = np.linspace(0, 1, 30)
CURVE = Curve(X, X**2, "rise", low=X**2 - 0.1, high=X**2 + 0.1)


def figures():
    pictures = np.random.default_rng(0).integers(0, 255, (5, 8, 8, 3)).astype(np.uint8)
    grid = np.add.outer(X[:6], X[:4])
    return {
        "curves": curves_figure([CURVE], "frame", "error", limits=[Limit(0.5, "epsilon")]),
        "panels": panels_figure([("one", [CURVE]), ("two", [CURVE])], "minutes", marks=[(0.3, "stage")]),
        "limited": panels_figure(
            [("one", [CURVE]), ("two", [CURVE])], "frame", y_label="error", limits=[Limit(0.5, "a"), Limit(0.1, "b")]
        ),
        "histogram": histogram_figure(X, "score", "number", limits=[Limit(0.2, "mean")]),
        "map": map_figure(grid, X[:4], X[:6], "elbow", "shoulder", "V"),
        "strip": strip_figure([CURVE], pictures, "angle", "V", x_spacing=0.25),
    }


@pytest.mark.parametrize("name", figures())
def test_a_figure_is_saved_as_png_and_as_svg_with_text(name, tmp_path):
    figure = figures()[name]
    save_figure(tmp_path / "a.png", figure)
    assert (tmp_path / "a.png").stat().st_size > 2000
    svg = figure_svg(figure, name)
    ElementTree.fromstring(svg.replace("xlink:", ""))
    words = {
        "curves": {"frame", "error", "epsilon", "rise"}, "panels": {"one", "two", "minutes", "stage"},
        "limited": {"one", "two", "frame", "error", "a", "b"},
        "histogram": {"score", "number", "mean"}, "map": {"elbow", "shoulder", "V"}, "strip": {"angle", "V"},
    }  # fmt: skip
    assert words[name] <= {word.strip() for word in re.findall(r">([^<>]+)</text>", svg)}


def test_ids_of_two_figures_in_one_page_differ():
    first, second = figure_svg(figures()["curves"], "a"), figure_svg(figures()["curves"], "b")

    def clips(svg):
        return set(re.findall(r'clipPath id="([^"]+)"', svg))

    assert clips(first) and not clips(first) & clips(second)


def test_each_colour_of_the_palette_is_its_own():
    colours = [INK.text, INK.quiet, INK.line, INK.one, INK.two, INK.three, INK.four, INK.limit, INK.paper]
    assert len(set(colours)) == len(colours)
