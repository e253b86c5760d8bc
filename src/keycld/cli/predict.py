"""The verb `keycld predict`."""

from pathlib import Path
from typing import Annotated

import tyro


def predict(
    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")],
    /,
    *,
    data: Path,
    out: Path,
    given: int | None = None,
    first: int = 0,
) -> None:
    """Predict all frames of every trajectory in a file from its given frames and its inputs alone.

    Args:
        run: Run folder, or a trained model of the package: pendulum, cartpole, acrobot.
        data: HDF5 file in keycld's format, with pictures or with states that keycld renders.
        out: HDF5 file to write: /image float32 [N, T, H, W, 3] and /keypoints [N, T, K, 2].
        given: Number of given frames; by default as many as the model needs.
        first: Number of the first given frame. A reversible model predicts the frames before it backward.
    """
    from keycld.evaluation import predict_file
    from keycld.training import Counted, load_model

    model, _ = load_model(run)
    predict_file(model, data, out, given=given, first=first, progress=Counted("predict"))
    print(f"predictions: {out}")
