from __future__ import annotations

import numpy as np
import pytest

from stillray.compare.display import tone_map
from stillray.errors import InputError
from stillray_training import contact_sheets
from stillray_training.contact_sheets import CROPS, Sheet, compose, read_sheets


def sheet(*crops):
    return Sheet(file="page", set="sequences", case="one", crops=crops)


def test_crops_are_enlarged_pixel_by_pixel_a_row_a_picture(rng):
    first, second = rng.random((2, 20, 30, 3)).astype(np.float32)
    page = compose(
        sheet(("left", 2, 3), ("right", 22, 12)), [("noisy", first), ("ours", second)],
        exposure=0.7, side=8, enlargement=3,
    )  # fmt: skip
    size, step = 24, 24 + contact_sheets.GAP
    for row, image in enumerate((first, second)):
        for column, (x, y) in enumerate(((2, 3), (22, 12))):
            top, left = contact_sheets.TOP + row * step, contact_sheets.LEFT + column * step
            crop = page[top : top + size, left : left + size]
            wanted = np.rint(255 * tone_map(image[y : y + 8, x : x + 8], 0.7))
            for offset in (0, 1, 2):  # every one of the nine pixels that show one
                np.testing.assert_array_equal(crop[offset::3, offset::3], wanted)
    labels = page[contact_sheets.TOP :, : contact_sheets.LEFT]
    assert (labels < 128).any()


@pytest.mark.parametrize("place", [(23, 0), (0, 13), (-1, 0)])
def test_a_crop_beyond_the_frame_is_refused(place):
    image = np.zeros((20, 30, 3), np.float32)
    with pytest.raises(InputError, match=rf"crop must lie within 30x20, got bars at {place[0]}"):
        compose(sheet(("bars", *place)), [("noisy", image)], exposure=1, side=8, enlargement=2)


def test_every_sheet_has_six_places_and_a_name_of_its_own():
    more = ("mirrors", "film")
    files = [CROPS, *(CROPS.with_name(f"contact_sheets_{kind}.toml") for kind in more)]
    read = [read_sheets(path) for path in files]
    assert {side * enlargement for side, enlargement, _ in read} == {192}
    sheets = [sheet for _, _, found in read for sheet in found]
    assert len({sheet.file for sheet in sheets}) == len(sheets)
    assert all(len(sheet.crops) == 6 for sheet in sheets)
