"""Pictures compared along the motion."""

import numpy as np
import pytest

from stillray import Frame
from stillray.compare.metrics import evaluate, tone_map
from stillray.compare.warping import Followed, warped, warping_error

HEIGHT, WIDTH, STEP = 9, 13, 3


@pytest.fixture
def texture() -> np.ndarray:
    return np.random.default_rng(3).uniform(0.1, 0.9, (HEIGHT, WIDTH, 3)).astype(np.float32)


def frame(**buffers) -> Frame:
    color = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    return Frame(color=color, depth=np.ones((HEIGHT, WIDTH), np.float32), **buffers)


def moved(**buffers) -> Frame:
    """A frame whose pixels were ``STEP`` pixels further right."""
    motion = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    motion[..., 0] = STEP
    return frame(motion=motion, **buffers)


def test_a_texture_that_moves_along_does_not_flicker(texture):
    followed = Followed.between(frame(), moved())
    shifted = np.roll(texture, -STEP, axis=1)
    assert warping_error(texture, shifted, texture, followed) == 0
    # what stays while the camera moves, as dirt on a lens, does
    assert warping_error(texture, texture, texture, followed) > 0.05


def test_error_is_that_of_loops_over_what_was_seen(texture):
    rng = np.random.default_rng(4)
    motion = rng.uniform(-4, 4, (HEIGHT, WIDTH, 2)).astype(np.float32)
    image = rng.uniform(0, 1, texture.shape).astype(np.float32)
    reference = np.full(texture.shape, 0.2, np.float32)  # which is shown as it is
    followed = Followed.between(frame(), frame(motion=motion))
    was, now = (tone_map(picture, 1.0).astype(np.float64) for picture in (texture, image))
    changes = []
    for y in range(HEIGHT):
        for x in range(WIDTH):
            at_x, at_y = x + float(motion[y, x, 0]), y + float(motion[y, x, 1])
            inside = 0 <= at_x <= WIDTH - 1 and 0 <= at_y <= HEIGHT - 1
            assert followed.seen[y, x] == inside
            if not inside:
                continue
            left, top = min(int(at_x), WIDTH - 2), min(int(at_y), HEIGHT - 2)
            across, down = at_x - left, at_y - top
            rows = [(1 - across) * was[r, left] + across * was[r, left + 1] for r in (top, top + 1)]
            changes.append(np.abs(now[y, x] - ((1 - down) * rows[0] + down * rows[1])).mean())
    assert warping_error(texture, image, reference, followed) == pytest.approx(
        np.mean(changes), rel=1e-4
    )


def test_what_was_uncovered_is_left_out(texture):
    depth = np.ones((HEIGHT, WIDTH), np.float32)
    depth[:, 4:6] = 3
    normal = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    normal[..., 2] = 1
    turned = normal.copy()
    turned[2] = (1, 0, 0)
    still = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    color = texture
    before = Frame(color=color, depth=np.ones_like(depth), normal=normal)
    after = Frame(color=color, depth=depth, normal=turned, motion=still)
    seen = Followed.between(before, after).seen
    assert not seen[:, 4:6].any()
    assert not seen[2].any()
    assert seen[:2, :4].all()


def test_background_is_followed(texture):
    """Where nothing was hit there is no normal and no depth."""
    nothing = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    still = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    one = Frame(color=texture, depth=nothing[..., 0], normal=nothing, motion=still)
    assert Followed.between(one, one).seen.all()


def test_motion_that_is_no_number_is_not_followed(texture):
    motion = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    motion[3, 3] = np.nan
    followed = Followed.between(frame(), frame(motion=motion))
    assert followed.seen.sum() == HEIGHT * WIDTH - 1
    assert warping_error(texture, texture, texture, followed) == 0


def test_it_is_measured_where_motion_is_known_and_something_was_seen(texture):
    two = [texture, texture]
    assert "warping" not in evaluate(two, two, names=["warping"])
    assert Followed.between(frame(), frame()) is None
    followed = Followed.between(frame(), moved())
    assert evaluate(two, two, names=["warping"], followed=followed)["warping"] > 0
    far = np.full((HEIGHT, WIDTH, 2), 1000, np.float32)
    nothing = Followed.between(frame(), frame(motion=far))
    assert "warping" not in evaluate(two, two, names=["warping"], followed=nothing)


def test_planes_and_colors_are_warped_alike(texture):
    positions = np.random.default_rng(5).uniform(0, 8, (4, 5, 2)).astype(np.float32)
    planes = [warped(np.ascontiguousarray(texture[..., c]), positions) for c in range(3)]
    assert np.array_equal(warped(texture, positions), np.stack(planes, axis=-1))
