"""Condenses evaluated runs into `results/`: python validation/record.py RUN [RUN ...]."""

import hashlib
import json
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent


def condensed(run: Path) -> dict:
    """Command, seed, commit, machine, cost and scores of a run."""
    config = json.loads((run / "config.json").read_text())
    environment = json.loads((run / "environment.json").read_text())
    last = json.loads((run / "metrics.jsonl").read_text().splitlines()[-1])
    decides = {k: v for k, v in config.items() if k not in ("command", "checkpoint_seconds", "data")}
    statistics = json.loads((Path(config["data"]) / "statistics.json").read_text())
    scores = {}
    for path in sorted((run / "evaluation").glob("*.json")):
        score = json.loads(path.read_text())
        if "vpt" not in score:
            continue
        scores[path.stem] = {
            "vpt": {
                factor: {k: v for k, v in value.items() if k != "frames"} for factor, value in score["vpt"].items()
            },
            "mse": score["mse"],
            "epsilon": score["epsilon"],
            "baselines": {name: value["vpt"]["1"]["mean"] for name, value in score["baselines"].items()},
            **{name: score[name] for name in ("state", "drift", "masses", "frames_passed") if name in score},
        }
    return {
        "command": f"keycld train {config['system']} --preset {config['preset']} --seed {config['seed']}",
        "system": config["system"],
        "model": config["model"],
        "preset": config["preset"],
        "settings": config["settings"],
        "seed": config["seed"],
        "commit": environment["commit"],
        "machine": {name: environment[name] for name in ("processor", "cores", "devices", "packages", "python")},
        "config_hash": hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()[:16],
        "data_hash": hashlib.sha256(json.dumps(statistics.get("recipe", {}), sort_keys=True).encode()).hexdigest()[:16],
        "training": {name: last[name] for name in ("seconds", "cpu_seconds", "frames")},
        "scores": scores,
    }


if __name__ == "__main__":
    for name in sys.argv[1:]:
        result = condensed(Path(name))
        out = ROOT / "results" / f"{result['model']}-{result['preset']}-{result['system']}-{result['seed']}.json"
        out.write_text(json.dumps(result, indent=1) + "\n")
        print(out.relative_to(ROOT))
