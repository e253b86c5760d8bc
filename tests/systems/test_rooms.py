"""Rooms: the path of the camera, and what its pictures show."""

import numpy as np
import pytest

from keycld.systems import Recording, Task, get, is_software, run_in_processes


@pytest.mark.parametrize("name", ["room/circle", "room/spiral"])
def test_the_camera_stays_on_the_hemisphere(name):
    recording = get(name).record(range(20), 256, "priors-paper", "default")
    place, velocity = recording.state[..., :3], recording.state[..., 3:]
    np.testing.assert_allclose(np.linalg.norm(place, axis=-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(place, axis=1), 0.05 * velocity[:, :-1], atol=1e-12)
    angle = np.unwrap(np.arctan2(place[..., 1], place[..., 0]))
    np.testing.assert_allclose(np.diff(angle), np.radians(0.1), atol=1e-9)
    radius = np.hypot(place[..., 0], place[..., 1])
    growth = 1.0 if "circle" in name else 1.0053611**25.5
    np.testing.assert_allclose(radius[:, -1] / radius[:, 0], growth, rtol=1e-9)


def pictures_of(name, recording):
    """In a process of its own, as data are made."""
    [(_, pictures)] = run_in_processes([Task(get(name).pictures, (recording,))])
    return pictures


def test_rooms_look_as_they_are_furnished():
    recording = get("room/circle").record(range(6), 3, "priors-paper", "default")
    # From above, so that the places of the objects can be read off the picture.
    state = recording.state.copy()
    state[..., :3] = [0.0, 0.0, 1.0]
    overhead = Recording(recording.time, state, recording.parameters | {"angle": np.full(6, -np.pi / 2)})
    image, renderer = pictures_of("room/circle", overhead)
    assert image.shape == (6, 3, 32, 32, 3) and image.dtype == np.uint8
    p, checked = recording.parameters, 0
    for i in range(6):
        for k in range(5):
            height = p["half_sizes"][i, k, 2] + (p["half_sizes"][i, k, 0] if p["shape"][i, k] == 1 else 0.0)
            x, y = p["place"][i, k] / (1 - 2 * height) / np.tan(np.radians(37.5))
            column, row = round(15.5 + 15.5 * x), round(15.5 - 15.5 * y)
            if 1 <= row <= 30 and 1 <= column <= 30 and np.hypot(*p["place"][i, k]) < 0.35:
                seen, own = image[i, 0, row, column] / 255.0, p["color"][i, k]
                assert seen @ own / np.linalg.norm(seen) / np.linalg.norm(own) > 0.97
                checked += 1
    assert checked >= 5
    assert is_software(renderer) or renderer


def test_rooms_turn_slowly():
    recording = get("room/spiral").record(range(2), 4, "priors-paper", "default")
    image = pictures_of("room/spiral", recording).image.astype(float)
    assert 0 < np.abs(np.diff(image, axis=1)).mean() < 3.0
    assert np.abs(image[0] - image[1]).mean() > 20
