"""Learn the physics of a moving thing from video, then predict and control it."""

from keycld._errors import KeycldError as KeycldError

__version__ = "0.1.0"
