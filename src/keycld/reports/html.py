"""The elements of a page; every function returns HTML as text."""

import base64
import html
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import imageio.v3
import numpy as np
from jaxtyping import UInt8

from keycld.drawing import INK, figure_svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TYPES = {".png": "image/png", ".gif": "image/gif", ".mp4": "video/mp4"}


def text(value: Any) -> str:
    """Return a value as text, escaped for HTML."""
    return html.escape("".join(c if c.isprintable() else " " for c in str(value)))


def title(name: str) -> str:
    """Return the name of a data set or a clip as the title of a page."""
    return text(name.rpartition("/")[2].replace("_", " ").capitalize())


def data_uri(path: Path) -> str:
    """Return the contents of a file as a data address, so that the page needs no other file."""
    return f"data:{_TYPES[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode()}"


def image(frame: UInt8[np.ndarray, "H W 3"], description: str, kind: str = "pixels") -> str:
    """Return an image; `kind="pixels"` keeps its pixels sharp when the page enlarges it."""
    png = imageio.v3.imwrite("<bytes>", frame, extension=".png")
    address = f"data:image/png;base64,{base64.b64encode(png).decode()}"
    height, width, _ = frame.shape
    return f'<img class="{kind}" src="{address}" alt="{text(description)}" width="{width}" height="{height}">'


def movie(path: Path, still: UInt8[np.ndarray, "H W 3"], fallback: Path | None, description: str) -> str:
    """Return a silent movie that plays in a loop.

    Args:
        path: MP4 file.
        still: frame that the browser shows before the movie plays.
        fallback: GIF for browsers that cannot play H.264; without one they show the still.
        description: for readers who do not see it.
    """
    png = imageio.v3.imwrite("<bytes>", still, extension=".png")
    poster = f"data:image/png;base64,{base64.b64encode(png).decode()}"
    height, width, _ = still.shape
    video = (
        f'<video autoplay loop muted playsinline width="{width}" height="{height}" poster="{poster}" '
        f'aria-label="{text(description)}" title="click to stop or go on">'
        f'<source src="{data_uri(path)}" type="video/mp4"></video>'
    )
    if fallback is None:
        return video
    return video + f'<img class="instead" hidden src="{data_uri(fallback)}" alt="{text(description)}">'


def chart(figure: "Figure", name: str) -> str:
    """Return a matplotlib figure as SVG in the colours and the font of the page."""
    # The rules of its own style element are in style.css: the page allows no other.
    svg = re.sub(r"<(metadata|style)\b.*?</\1>\s*", "", figure_svg(figure, name), flags=re.S)
    for role in ("text", "quiet", "line", "one", "two", "three", "four", "limit"):
        svg = svg.replace(getattr(INK, role), f"var(--{role})")
    # `font: 9px 'DejaVu Sans', …, sans-serif`: keep the size, replace the family.
    svg = re.sub(r"(font: [^'\";]*?px) [^;\"]*", r"\1 var(--sans)", svg)
    width = re.search(r'viewBox="0 0 ([\d.]+) ', svg)
    points = float(width.group(1)) if width else 400.0
    return re.sub(
        r"<svg[^>]*?(viewBox=\"[^\"]*\")[^>]*>",
        rf'<svg class="chart" role="img" style="max-width:{points * 4 / 3:.0f}px" '
        r'xmlns:xlink="http://www.w3.org/1999/xlink" \1>',
        svg,
        count=1,
    )


def figure(contents: str, caption: str = "", kind: str = "") -> str:
    """Return contents with a caption below, which may hold HTML."""
    below = f"<figcaption>{caption}</figcaption>" if caption else ""
    return f'<figure class="{kind}">{contents}{below}</figure>'


def grid(items: Iterable[str], kind: str = "two") -> str:
    """Return items next to each other, as many in a row as the width allows."""
    return f'<div class="grid {kind}">{"".join(items)}</div>'


def section(name: str, title: str, contents: str) -> str:
    """Return a section with a heading."""
    return f'<section id="{name}"><h2>{text(title)}</h2>{contents}</section>'


def contents(sections: str) -> str:
    """Return links to the sections that are there, in their order."""
    found = re.findall(r'<section id="(\w+)"><h2>(.*?)</h2>', sections)
    return "<nav>" + "".join(f'<a href="#{name}">{title}</a>' for name, title in found) + "</nav>"


def paragraph(contents: str, kind: str = "") -> str:
    """Return a paragraph, which may hold HTML."""
    return f'<p class="{kind}">{contents}</p>'


def missing(name: str, title: str, what: str) -> str:
    """Return the line that replaces a section without results."""
    return f'<p class="missing" id="{name}"><b>{text(title)}</b> is left out: {text(what)}.</p>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], kind: str = "") -> str:
    """Return a table; cells may hold HTML, and the first one of a row is its heading."""
    top = "".join(f'<th scope="col">{cell}</th>' for cell in head)
    body = "".join(
        f'<tr><th scope="row">{first}</th>' + "".join(f"<td>{cell}</td>" for cell in rest) + "</tr>"
        for first, *rest in rows
    )
    rows_of_cells = f"<thead><tr>{top}</tr></thead><tbody>{body}</tbody>"
    return f'<div class="scroll"><table class="{kind}">{rows_of_cells}</table></div>'


def pairs(values: Mapping[str, Any]) -> str:
    """Return a table of names and values of a configuration; nested names are dotted."""
    rows = "".join(f"<tr><th scope='row'>{text(name)}</th><td>{text(value)}</td></tr>" for name, value in _flat(values))
    return f'<div class="scroll"><table class="pairs"><tbody>{rows}</tbody></table></div>'


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def bars(rows: Sequence[tuple[str, float, str]]) -> str:
    """Return horizontal bars from 0 to 1; each row is label, value and the class for its colour."""
    lines = "".join(
        f'<div class="bar {kind}"><span>{text(label)}</span><i><b style="width:{100 * value:.1f}%"></b></i>'
        f"<em>{value:.2f}</em></div>"
        for label, value, kind in rows
    )
    return f'<div class="bars">{lines}</div>'


def number(value: float | None) -> str:
    """Return a number with three digits, with a power of ten where needed."""
    if value is None or not np.isfinite(value):
        return "not finite"
    shown = f"{value:.3g}"
    if "e" not in shown:
        return shown
    digits, power = shown.split("e")
    return f"{digits}·10<sup>{str(int(power)).replace('-', '−')}</sup>"


def percent(share: float | None) -> str:
    """Return a share as a percentage with three digits."""
    return f"{number(None if share is None else 100 * share)} %"
