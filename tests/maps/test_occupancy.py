"""Reading a ROS map_server pair: what every field means, and what is said when one is wrong."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxnav.maps import occupancy
from jaxnav.maps.occupancy import FREE, OCCUPIED, UNKNOWN

SHADES = np.array([[0, 89, 90, 205, 206, 254]], np.uint8)  # 255 (1 - 0.65) = 89.25, 255 (1 - 0.196) = 205.02


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, [OCCUPIED, OCCUPIED, UNKNOWN, UNKNOWN, FREE, FREE]),
        ({"mode": "scale"}, [OCCUPIED, OCCUPIED, UNKNOWN, UNKNOWN, FREE, FREE]),
        ({"negate": 1}, [FREE, UNKNOWN, UNKNOWN, OCCUPIED, OCCUPIED, OCCUPIED]),
        ({"negate": "true"}, [FREE, UNKNOWN, UNKNOWN, OCCUPIED, OCCUPIED, OCCUPIED]),
        ({"mode": "raw"}, [FREE, OCCUPIED, OCCUPIED, UNKNOWN, UNKNOWN, UNKNOWN]),
        ({"free_thresh": "1e-3", "occupied_thresh": 0.5}, [OCCUPIED] * 3 + [UNKNOWN] * 3),
    ],
)
def test_a_shade_is_free_occupied_or_unknown(write_map, fields, expected):
    assert occupancy.read(write_map(SHADES, **fields)).cells.tolist() == [expected]


def test_colours_are_averaged(write_map):
    image = np.array([[[255, 0, 0], [255, 255, 255], [255, 255, 110]]], np.uint8)  # means 85, 255, 206.7
    assert occupancy.read(write_map(image)).cells.tolist() == [[OCCUPIED, FREE, FREE]]


@pytest.mark.parametrize(
    ("mode", "expected"),
    [("trinary", [FREE, UNKNOWN, OCCUPIED, OCCUPIED]), ("scale", [FREE, UNKNOWN, OCCUPIED, UNKNOWN])],
)
def test_alpha_is_averaged_in_mode_trinary_and_means_unknown_in_scale(write_map, mode, expected):
    """White seen through half is (3 x 255 + 0) / 4 = 191; black opaque is 255 / 4 = 64, transparent 0."""
    image = np.array([[[255] * 4, [255, 255, 255, 0], [0, 0, 0, 255], [0, 0, 0, 0]]], np.uint8)
    assert occupancy.read(write_map(image, mode=mode)).cells.tolist() == [expected]


@pytest.mark.parametrize("suffix", ["pgm", "png", "bmp"])
def test_the_top_row_of_the_image_is_the_one_of_greatest_y(tmp_path, write_map, suffix):
    image = np.zeros((3, 4), np.uint8)
    image[0, 1] = 254
    cv2.imwrite(str(tmp_path / f"other.{suffix}"), image)
    building = occupancy.read(write_map(image, image=f"other.{suffix}", resolution=0.5, origin=[1.0, -2.0, 0.0]))
    assert np.argwhere(building.cells == FREE).tolist() == [[2, 1]]
    np.testing.assert_allclose(building.to_world([1.5, 2.5]), [1.75, -0.75])


def test_yaw_turns_the_map_about_the_corner_of_its_first_cell(write_map):
    building = occupancy.read(write_map(np.zeros((3, 4), np.uint8), resolution=0.5, origin=[1.0, -2.0, np.pi / 2]))
    np.testing.assert_allclose(building.to_world([[0, 0], [4, 0], [0, 3]]), [[1, -2], [1, 0], [-0.5, -2]], atol=1e-12)


@given(
    yaw=st.floats(-7, 7),
    x=st.floats(-99, 99),
    y=st.floats(-99, 99),
    scale=st.floats(0.01, 1),
    point=st.floats(-99, 999),
)
def test_to_cells_undoes_to_world(yaw, x, y, scale, point):
    building = occupancy.OccupancyMap(cells=np.zeros((1, 1), np.uint8), resolution=scale, origin=(x, y, yaw))
    points = np.array([[point, 1.0], [0.0, -point]])
    np.testing.assert_allclose(building.to_cells(building.to_world(points)), points, atol=1e-6)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"resolution": None}, "no field resolution"),
        ({"resolution": 0.0}, "resolution is 0.0: .* above 0"),
        ({"resolution": -0.05}, "resolution is -0.05"),
        ({"resolution": ".nan"}, "resolution is nan: give a finite number"),
        ({"resolution": "five"}, "resolution is 'five'"),
        ({"resolution": "true"}, "resolution is True"),
        ({"origin": None}, "no field origin"),
        ({"origin": [0.0, 0.0]}, r"origin is \[0.0, 0.0\]: give \[x, y, yaw\]"),
        ({"origin": "[0, 0, .inf]"}, "origin is inf"),
        ({"origin": f"[1{400 * '0'}, 0, 0]"}, "origin is 10000"),
        ({"origin": [500_000, 5_400_000, 0]}, r"origin is \[500000, 5400000, 0\], farther than 10 km: .* near 0"),
        ({"origin": [-10_001.0, 0.0, 0.0]}, "origin is .*, farther than 10 km"),
        ({"negate": 2}, "negate is 2: give 0 or 1"),
        ({"negate": None}, "no field negate"),
        ({"free_thresh": 0.7}, "free_thresh is 0.7 and occupied_thresh 0.65"),
        ({"occupied_thresh": 65}, "free_thresh < occupied_thresh <= 1"),
        ({"occupied_thresh": "[0.65]"}, r"occupied_thresh is \[0.65\]"),
        ({"mode": "ternary"}, "mode is 'ternary': choose from trinary, scale, raw"),
        ({"image": None}, "no field image"),
        ({"image": 7}, "image is 7"),
        ({"image": "moon.png"}, "image .*moon.png is missing"),
        ({"image": "map.yaml"}, "image .*map.yaml can't be read: save it as pgm or png"),
    ],
)
def test_a_wrong_field_is_named_with_its_value_and_the_remedy(write_map, fields, said):
    path = write_map(SHADES, **fields)
    with pytest.raises(ValueError, match=said) as error:
        occupancy.read(path)
    assert str(path) in str(error.value)


def test_a_truncated_image_is_refused_in_one_line(write_map, capfd):
    """OpenCV, too, would print an error; it does so again afterwards."""
    path = write_map(SHADES, image="map.pgm")
    pixels = cv2.imencode(".pgm", np.zeros((100, 100), np.uint8))[1].tobytes()
    (path.parent / "map.pgm").write_bytes(pixels[:1000])
    level = cv2.utils.logging.getLogLevel()
    with pytest.raises(ValueError, match=r"map.pgm can't be read: save it as pgm or png"):
        occupancy.read(path)
    assert capfd.readouterr().err == ""
    assert cv2.utils.logging.getLogLevel() == level


def test_an_image_of_16_bits_does_not_match_its_thresholds(write_map):
    with pytest.raises(ValueError, match="16 bits a channel"):
        occupancy.read(write_map(np.full((2, 2), 60_000, np.uint16)))


@pytest.mark.parametrize(
    ("text", "said"),
    [(b"- 1\n- 2\n", "holds no fields"), (b"image: [", "can't be read"), (b"\xff\xfe\x00", "can't be read")],
)
def test_a_file_that_is_no_map_is_refused(tmp_path, text, said):
    path = tmp_path / "map.yaml"
    path.write_bytes(text)
    with pytest.raises(ValueError, match=said):
        occupancy.read(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"moon.yaml is missing: give the path"):
        occupancy.read(tmp_path / "moon.yaml")
    with pytest.raises(ValueError, match="can't be read"):
        occupancy.read(tmp_path)
