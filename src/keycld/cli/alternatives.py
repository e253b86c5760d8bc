"""`keycld watch --mechanism auto`: which mechanisms a clip may show."""

from collections.abc import Mapping, Sequence
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Any

from keycld._files import replacing, write_text
from keycld._records import read_json

if TYPE_CHECKING:
    from keycld.evaluation.physics_file import Alternative

AUTO = "auto"
"""The mechanism that is not told."""
NOT_IDENTIFIABLE = (
    "not identifiable from this clip: no mechanism was found whose constraints hold and whose motion can be predicted. "
    "Parts must differ in colour from each other and from the ground; otherwise name the mechanism with --mechanism."
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
    from keycld.data import before_test, import_clip, open_data
    from keycld.mechanics import dump_constraints
    from keycld.models.keycld.discover import discover

    stored, toml = (run / name for name in COMPARISON)
    if stored.exists():
        found = read_json(stored, dict[str, Any], f"delete {run}")["alternatives"]
        return next((each["mechanism"] or str(toml) for each in found if each["chosen"]), None), found
    # What is looked at lies next to the file that it is for: it goes with it, also where this fails or is killed.
    with replacing(stored) as temporary:
        looked = temporary.with_name("looked")
        import_clip(clip, looked, constraints=None, size=_SIDE, **options)
        data = open_data(looked)
        images, train = before_test(data), data.split("train", images=False)
        assert images.image is not None
        judged = discover(images.image.reshape(-1, _SIDE, _SIDE, 3), len(train) * train.frames, images.dt)
        found = []
        for each in judged:
            candidate = each.candidate
            found.append(
                {
                    "mechanism": candidate.mechanism,
                    "keypoints": list(candidate.constraints.keypoints),
                    "constraints": candidate.residuals,
                    "freedom": candidate.freedom,
                    "prediction": each.error,
                    "chosen": each.chosen,
                }
            )
            if each.chosen and candidate.mechanism is None:
                write_text(toml, dump_constraints(candidate.constraints))
        temporary.write_text(dumps({"alternatives": found}, indent=1) + "\n", encoding="utf-8")
    return next((each["mechanism"] or str(toml) for each in found if each["chosen"]), None), found


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
