"""A recording's pictures are found in order whatever its layout, and a broken one is explained."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_agent.cameras.recordings import list_images
from robot_agent.errors import CameraError


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def found(folder: Path) -> list[tuple[str, float | None]]:
    return [(str(image.path.relative_to(folder)), image.time_s) for image in list_images(folder)]


def test_a_plain_folder_gives_its_pictures_by_name_without_times(tmp_path):
    touch(tmp_path, "b.png", "a.JPG", "c.pgm", "notes.txt", "a.jpg.bak")
    assert found(tmp_path) == [("a.JPG", None), ("b.png", None), ("c.pgm", None)]


def test_an_otb_folder_has_its_pictures_in_img(tmp_path):
    touch(tmp_path, "img/0002.jpg", "img/0001.jpg", "groundtruth_rect.txt", "preview.png")
    assert found(tmp_path) == [("img/0001.jpg", None), ("img/0002.jpg", None)]


def test_a_tum_folder_gives_files_and_times_in_the_order_of_its_list(tmp_path):
    (tmp_path / "rgb.txt").write_text(
        "# color images\n# timestamp filename\n1305031102.175304 rgb/a.png\n\n1305031102.211214 rgb/b.png\n"
    )
    assert found(tmp_path) == [("rgb/a.png", 1305031102.175304), ("rgb/b.png", 1305031102.211214)]


@pytest.mark.parametrize("place", ["mav0/cam0", "cam0", "."])
def test_an_euroc_folder_gives_files_and_nanoseconds_as_seconds(tmp_path, place):
    table = tmp_path / place / "data.csv"
    table.parent.mkdir(parents=True, exist_ok=True)
    table.write_text("#timestamp [ns],filename\r\n1403636579763555584,a.png\r\n1403636579813555456, b.png\r\n")
    (first, first_s), (second, second_s) = found(tmp_path)
    prefix = "" if place == "." else f"{place}/"
    assert (first, second) == (f"{prefix}data/a.png", f"{prefix}data/b.png")
    assert first_s == pytest.approx(1403636579.763555584, abs=1e-6)
    assert second_s is not None
    assert first_s is not None
    assert second_s - first_s == pytest.approx(0.05, abs=1e-5)


@pytest.mark.parametrize("make", [lambda folder: None, lambda folder: touch(folder, "readme.md", "img/list.txt")])
def test_a_folder_without_pictures_says_what_it_must_hold(tmp_path, make):
    make(tmp_path)
    with pytest.raises(CameraError, match=r"No pictures in .* jpg or png"):
        list_images(tmp_path)


def test_an_empty_list_of_pictures_is_no_recording(tmp_path):
    (tmp_path / "rgb.txt").write_text("# nothing but a comment\n")
    with pytest.raises(CameraError, match="No pictures"):
        list_images(tmp_path)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("rgb.txt", "1.0 a.png\n2.0\n", r"rgb\.txt, entry 2: a time and a file are expected, not '2\.0'"),
        ("rgb.txt", "noon a.png\n", r"rgb\.txt, entry 1: 'noon' is not a time"),
        ("data.csv", "#t,f\n1000,a.png\n2000\n", r"data\.csv, entry 2: a time and a file are expected"),
        ("data.csv", "late,a.png\n", r"data\.csv, entry 1: 'late' is not a time"),
        ("rgb.txt", "nan a.png\n", r"rgb\.txt, entry 1: 'nan' is not a time"),
        ("data.csv", "inf,a.png\n", r"data\.csv, entry 1: 'inf' is not a time"),
    ],
)
def test_a_broken_list_names_file_and_entry(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(CameraError, match=message):
        list_images(tmp_path)


def test_a_list_in_another_encoding_is_read_as_far_as_it_matters(tmp_path):
    (tmp_path / "rgb.txt").write_bytes(b"# caf\xe9\n1.5 a.png\n")
    assert found(tmp_path) == [("a.png", 1.5)]
