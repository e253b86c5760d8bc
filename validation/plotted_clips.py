"""Animations of double pendulums as a plotting library makes them: axes, a grid, thin lines, small discs, a clock.

`watched_clips.py` watches them.
"""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from validation.drawn_clips import Camera, Drawn, double_pendulum, hanging


def plotted_discs(random: np.random.Generator, camera: Camera) -> Drawn:
    """Discs of two colours on black lines."""
    return _plotted(random, camera, ("tab:blue", "tab:orange"), 14, "k", 0)


def plotted_line(random: np.random.Generator, camera: Camera) -> Drawn:
    """Small discs and links of one colour, and the time in a corner."""
    return _plotted(random, camera, ("tab:blue", "tab:blue"), 6, "tab:blue", 0)


def plotted_trace(random: np.random.Generator, camera: Camera) -> Drawn:
    """The same with the last forty places of the tip."""
    return _plotted(random, camera, ("tab:blue", "tab:blue"), 6, "tab:blue", 40)


def _plotted(
    random: np.random.Generator, camera: Camera, colours: tuple[str, str], size: float, links: str, trace: int
) -> Drawn:
    lengths, masses = (random.uniform(0.8, 1.1), random.uniform(0.6, 1.0)), (1.0, random.uniform(0.5, 1.0))
    angles = double_pendulum(np.array([*random.uniform(0.9, 1.5, 2), 0, 0]), lengths, masses, 0.02, camera)
    along = [length * np.stack([np.sin(a), -np.cos(a)], 1) for length, a in zip(lengths, angles.T, strict=True)]
    elbow, tip = along[0], along[0] + along[1]
    figure = Figure(figsize=(5, 4), dpi=80)
    canvas, axes = FigureCanvasAgg(figure), figure.add_subplot()
    axes.set(xlim=(-2.2, 2.2), ylim=(-2.2, 2.2), aspect="equal")
    axes.grid()
    (passed,) = axes.plot([], [], ".-", lw=1, ms=2, color="tab:orange")
    (rods,) = axes.plot([], [], "-", lw=2, color=links)
    (first,), (second,) = (axes.plot([], [], "o", ms=size, color=colour) for colour in colours)
    axes.plot(0, 0, "o", ms=6, color=links)
    clock, frames = axes.text(-2, 1.9, ""), []
    for t in range(camera.frames):
        passed.set_data(*tip[max(0, t - trace) : t].T)
        rods.set_data(*np.stack([0 * elbow[t], elbow[t], tip[t]]).T)
        first.set_data(*elbow[t : t + 1].T)
        second.set_data(*tip[t : t + 1].T)
        clock.set_text(f"time = {t / camera.fps:.1f}s")
        canvas.draw()
        frames.append(np.array(canvas.buffer_rgba())[..., :3])
    return Drawn(np.array(frames), hanging(lengths, masses, 0.02) | {"gravity_direction": -90.0})


PLOTTED = {
    "plotted_discs": (plotted_discs, "double-pendulum"),
    "plotted_line": (plotted_line, "double-pendulum"),
    "plotted_trace": (plotted_trace, "double-pendulum"),
}
"""What is plotted, and the mechanism that it shows."""
