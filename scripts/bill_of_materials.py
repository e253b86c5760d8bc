"""Print the software bill of materials of `requirements.lock` as CycloneDX JSON: names, versions and hashes."""

import json
import re
from pathlib import Path

LOCK = Path(__file__).parent.parent / "requirements.lock"


def bill(lock: str) -> dict:
    """Return the bill of a lock file as pip-compile writes it."""
    parts = []
    for name, version, rest in re.findall(r"^([\w.-]+)==(\S+) \\\n((?:    --hash=\S+(?: \\)?\n)+)", lock, re.M):
        hashes = [{"alg": "SHA-256", "content": each} for each in re.findall(r"sha256:([0-9a-f]{64})", rest)]
        package = f"pkg:pypi/{name}@{version}"
        # One hash for each file of the release: a component has one set, so they are listed as its distributions.
        files = [{"type": "distribution", "url": package, "hashes": [each]} for each in hashes]
        parts.append(
            {"type": "library", "bom-ref": package, "name": name, "version": version, "purl": package}
            | {"externalReferences": files}
        )
    return {"bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1, "components": parts}


if __name__ == "__main__":
    print(json.dumps(bill(LOCK.read_text()), indent=1))
