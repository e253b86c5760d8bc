"""The colours of all pictures and figures: a colour means the same everywhere."""

from dataclasses import dataclass

# Vivid and far apart in hue, so that they stand out from any scene and can be told apart.
KEYPOINT_COLOURS = (
    (255, 45, 139),
    (0, 200, 255),
    (255, 196, 0),
    (140, 230, 70),
    (170, 110, 255),
    (255, 120, 50),
)


@dataclass(frozen=True)
class Ink:
    """Colours of figures, as hexadecimal strings.

    Each colour occurs once, so a page can replace it (in a dark theme, for example).
    """

    paper: str = "#ffffff"
    text: str = "#1f2328"
    quiet: str = "#6b7280"
    line: str = "#d9dce1"
    one: str = "#2463c9"
    two: str = "#d9622b"
    three: str = "#2f8f5b"
    four: str = "#8a5cc2"
    limit: str = "#c62f3f"

    @property
    def cycle(self) -> tuple[str, ...]:
        """The colours of successive curves."""
        return (self.one, self.two, self.three, self.four, self.quiet)


INK = Ink()
