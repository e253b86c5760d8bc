"""`keycld watch --mechanism auto`: which mechanisms a clip may show."""

from collections.abc import Mapping, Sequence
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Any

from keycld._files import hidden_folder, replacing, write_text
from keycld._records import read_json

if TYPE_CHECKING:
    from keycld.evaluation import Physics
    from keycld.evaluation.physics_file import Alternative
    from keycld.mechanics import Scale
    from keycld.models.keycld.discover import Judged
    from keycld.models.keycld.selection import Tried

AUTO = "auto"
"""The mechanism that is not told."""
NOT_IDENTIFIABLE = (
    "not identifiable from this clip: no mechanism was found whose constraints hold and whose motion can be predicted. "
    "Parts must differ in colour from each other and from the ground; otherwise name the mechanism with --mechanism."
)
WITHOUT_A_MODEL = (
    "no network has learned this clip. The constants are measured on the middles of its parts, told apart by their "
    "colours, in the first two thirds; the last third is not predicted."
)
COMPARISON = ("alternatives.json", "mechanism.toml")
"""Files of a run folder: all that were compared, and the chosen one if it has no name."""
# Pixels of a side of the pictures in which a mechanism is looked for.
_SIDE = 128


def compare(clip: Path, run: Path, options: Mapping[str, Any]) -> "tuple[str | None, list[Alternative]]":
    """Return the mechanism that a clip shows, None if no one can tell, and all that were compared.

    It writes them into the run folder, and reads them there if they are there already.

    Args:
        clip: a video.
        run: the run folder; the chosen mechanism is written there as TOML if it has no name.
        options: of `import_clip`.
    """
    from keycld.evaluation.physics_file import Comparison
    from keycld.mechanics import dump_constraints

    stored, toml = (run / name for name in COMPARISON)
    if stored.exists():
        found = read_json(stored, Comparison, f"delete {run}")["alternatives"]
        return next((each["mechanism"] or str(toml) for each in found if each["chosen"]), None), found
    # What is looked at lies next to the file that it is for: it goes with it, also where this fails or is killed.
    with replacing(stored) as temporary:
        judged, _ = _judged(clip, temporary.with_name("looked"), options)
        found = [_alternative(each) for each in judged]
        for each in judged:
            if each.chosen and each.candidate.mechanism is None:
                write_text(toml, dump_constraints(each.candidate.constraints))
        temporary.write_text(dumps({"alternatives": found}, indent=1) + "\n", encoding="utf-8")
    return next((each["mechanism"] or str(toml) for each in found if each["chosen"]), None), found


def name_of(mechanism: str, run: Path) -> str | None:
    """Return the name of a mechanism or of its TOML file; None for one without a name, which `compare` has written."""
    return None if mechanism == str(run / COMPARISON[1]) else Path(mechanism).stem


def measure_parts(
    clip: Path, run: Path, options: Mapping[str, Any], mechanism: str, tried: "Tried | None", scale: "Scale | None"
) -> "Physics | None":
    """Measure the constants of a clip on the middles of its parts; None unless these are those of the mechanism.

    Args:
        clip: a video.
        run: the run folder, for temporary files.
        options: of `import_clip`.
        mechanism: its name or TOML file.
        tried: which forces are tried; None: all.
        scale: a known length or g.
    """
    from keycld.evaluation import measure_tracks, restless
    from keycld.mechanics import dump_constraints, load_constraints
    from keycld.vision import pixel_size

    with hidden_folder(run / "looked") as folder:
        judged, dt = _judged(clip, folder / "looked", options)
    told = dump_constraints(load_constraints(mechanism))
    found = next((each.candidate for each in judged if each.chosen), None)
    if found is None or dump_constraints(found.constraints) != told:
        return None
    pixel = pixel_size(_SIDE, _SIDE)
    measured = measure_tracks(found, dt, tried=tried, pixel=pixel, scale=scale)
    if measured is None:
        return None
    noise = dict(zip(found.constraints.keypoints, (measured.estimate.noise / pixel).tolist(), strict=True))
    if caution := restless(noise):
        print(f"caution      {caution}", flush=True)
    return {
        **measured.physics,
        "mechanism": name_of(mechanism, run),
        "prediction": {"noise": noise},
        "alternatives": [_alternative(each) for each in judged],
        "note": WITHOUT_A_MODEL,
    }


def _judged(clip: Path, looked: Path, options: Mapping[str, Any]) -> "tuple[list[Judged], float]":
    """Return the mechanisms that a clip may show, and the seconds between its frames; its data go into a new folder."""
    from keycld.data import before_test, import_clip, open_data
    from keycld.models.keycld.discover import discover

    import_clip(clip, looked, constraints=None, size=_SIDE, **options)
    data = open_data(looked)
    images, train = before_test(data), data.split("train", images=False)
    assert images.image is not None
    frames = images.image.reshape(-1, _SIDE, _SIDE, 3)
    return discover(frames, len(train) * train.frames, images.dt), float(images.dt)


def _alternative(each: "Judged") -> "Alternative":
    candidate = each.candidate
    return {
        "mechanism": candidate.mechanism,
        "keypoints": list(candidate.constraints.keypoints),
        "constraints": candidate.residuals,
        "freedom": candidate.freedom,
        "prediction": each.error,
        "chosen": each.chosen,
    }


def alternatives_table(found: "Sequence[Alternative]") -> str:
    """Return the mechanisms that were compared as text, a line each."""
    lines = []
    for each in found:
        held = ", ".join(f"{name} ({residual:.1%})" for name, residual in each["constraints"].items()) or "none"
        error = "–" if each["prediction"] is None else f"{each['prediction']:.1%}"
        mark = "*" if each["chosen"] else " "
        lines.append(
            f"{mark} {each['mechanism'] or 'without a name':16} {len(each['keypoints'])} keypoints, freedom "
            f"{each['freedom']}, prediction off by {error}; constraints (residual): {held}"
        )
    return "\n".join(lines)
