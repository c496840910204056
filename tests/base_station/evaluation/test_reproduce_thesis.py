"""The thesis's experiments: what each listing finds, and that the command writes all figures and a page that holds."""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from base_station.errors import StationError
from base_station.evaluation.thesis import listings, pictures
from base_station.evaluation.thesis.comparison import CASES, THESIS_NAME, run_case
from base_station.evaluation.thesis.reproduce import main
from base_station.trackers.registry import make_tracker
from base_station.trackers.ztransform.thesis.z_shift import ZShiftSettings, ZShiftTracker

ROOT = Path(__file__).parents[3]
FIGURES = (
    "figure-2-5", "figure-2-6", "figure-3-5", "figure-4-2", "figure-4-3", "figure-4-4", "figure-4-4-causes",
    "figure-4-4-z", "figure-4-5", "figure-4-6", "figure-4-7", "figure-4-7-mended", "method-windows",
    "method-recursion", "method-zoom", "comparison-scenes", "comparison-answers", "comparison-brightness",
    "comparison-cost",
)  # fmt: skip
ALL, LISTED = np.arange(1, 101), np.arange(1, 11)


@pytest.fixture(scope="module")
def rows():
    """before, after with zeros at the border, after with real pixels there; of three pictures and a shift each."""
    found = []
    for seed, shift in ((0, 7), (1, 20), (2, 50)):
        picture = pictures.room(seed)
        before = pictures.view(picture)
        zeros, real = pictures.blacked(before, -shift), pictures.view(picture, -shift)
        found.append((shift, before[199], zeros[199], real[199]))
    return found


def test_cause_one_the_border_at_z_below_one(rows):
    for shift, before, zeros, real in rows:
        assert listings.answer(before, zeros, 0.9, ALL) == shift
        assert listings.answer(before, real, 0.9, ALL) <= 3
        assert listings.answer(before, real, 1.1, ALL) == shift


def test_cause_two_the_excess_weighted_twice(rows):
    """Exact by eq. (3.4), wrong as listed at 1.1, and as listed at 0.9 not to be seen."""
    for shift, before, zeros, _ in rows:
        assert listings.answer(before, zeros, 1.1, ALL) == shift
        assert listings.answer(before, zeros, 1.1, ALL, as_listed=True) != shift
        assert listings.answer(before, zeros, 0.9, ALL, as_listed=True) == shift


def test_cause_three_ten_shifts(rows):
    for shift, before, zeros, _ in rows:
        assert listings.answer(before, zeros, 0.9, LISTED, as_listed=True) == min(shift, 10)


def test_listing_is_the_loop_of_the_thesis(rows):
    """Lines 33 to 57 of listing A.3, index by index, against the vectorised form."""
    _, before, after, _ = rows[0]
    z, w = 0.9, len(before)
    right, left = before[w // 2 :].astype(float), after[w // 2 :].astype(float)
    x1 = sum(z ** -(n - 1) * right[n - 1] for n in range(1, len(right) + 1))
    x2 = sum(z ** -(n - 1) * left[n - 1] for n in range(1, len(left) + 1))
    expected = []
    for n0 in range(1, 11):
        excess = [float(after[w // 2 - n0 + i]) * z ** (n0 - i) for i in range(n0)]
        expected.append(x2 - z**n0 * (x1 - sum(excess)))
    np.testing.assert_allclose(listings.errors(before, after, z, LISTED, as_listed=True), expected, rtol=1e-9, atol=1e5)


def test_regions_with_zeros_at_the_border_always_blame_the_last():
    for seed in range(5):
        before = pictures.view(pictures.room(seed))
        after = pictures.blacked(before, -20)
        changes = np.abs(listings.regions(before[199], 0.9, 4) - listings.regions(after[199], 0.9, 4))
        assert changes.argmax() == 3


def test_a_view_moves_what_it_shows():
    picture = pictures.room(0)
    still, moved = pictures.view(picture), pictures.view(picture, 12, 5)
    assert (moved[5:, 12:] == still[:-5, :-12]).all()
    assert np.abs(pictures.view(picture, 0.5).astype(int) - still).max() > 0
    assert pictures.blacked(still, -20)[:, -20:].max() == 0


def test_the_comparison_counts_every_frame_once():
    trackers = {
        "z-shift": lambda: make_tracker("z-shift"),
        THESIS_NAME: lambda: ZShiftTracker(settings=ZShiftSettings.thesis()),
    }
    ticks = iter(range(10**6))
    good = run_case(CASES[0], [pictures.room(0)], trackers, frames=12, seed=0, timer=lambda: next(ticks) * 1e-6)
    assert good["z-shift"].share("right") == 1
    assert good[THESIS_NAME].share("wrong") > 0.5
    assert {tally.frames for tally in good.values()} == {12}
    assert good["z-shift"].times_us == pytest.approx([1.0] * 12)
    wall = run_case(CASES[-1], [pictures.wall(0)], trackers, frames=5, seed=0)
    assert wall["z-shift"].share("refused") == 1


class Links(HTMLParser):
    """Collects what a page refers to, its anchors, and whether pictures have a text."""

    def __init__(self) -> None:
        super().__init__()
        self.files, self.jumps, self.anchors, self.alts, self.headings = [], [], set(), [], 0

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.headings += tag in ("h2", "h3")
        if "id" in values:
            self.anchors.add(values["id"])
        if tag == "img":
            self.alts.append(values.get("alt", ""))
        for link in (values.get("src"), values.get("srcset"), values.get("href")):
            if link:
                (self.jumps if link.startswith("#") else self.files).append(link)


def test_writes_every_figure_and_a_page_whose_links_exist(tmp_path):
    out = tmp_path / "figures"
    assert main(["--quick", "--out", str(out)]) == 0
    page = (out / "index.html").read_text(encoding="utf-8")
    links = Links()
    links.feed(page)
    assert sorted(links.files) == sorted(f"{name}.png" for name in FIGURES)
    for name in links.files:
        image = cv2.imread(str(out / name))
        assert image is not None and image.std() > 5, name
    assert {jump[1:] for jump in links.jumps} == links.anchors == {*FIGURES, "table"}
    assert all(len(alt) > 20 for alt in links.alts) and len(links.alts) == len(FIGURES)
    assert "http" not in page and "<script" not in page
    assert "prefers-color-scheme: dark" in page
    assert f"--out {out}" in page


def test_the_readme_shows_pictures_that_exist_and_are_small():
    readme = ROOT / "base_station/trackers/ztransform/README.md"
    shown = re.findall(r"!\[[^\]]{20,}\]\(([^)]+)\)", readme.read_text(encoding="utf-8"))
    assert len(shown) >= 4
    for link in shown:
        path = (readme.parent / link).resolve()
        assert path.parent == ROOT / "scripts/figures" and path.stem in FIGURES
        assert 5_000 < path.stat().st_size < 150_000
        assert cv2.imread(str(path)) is not None


def test_own_pictures_are_read_and_brought_to_size(tmp_path):
    rng = np.random.default_rng(0)
    for number, shape in enumerate(((300, 900), (1500, 1000, 3), (720, 880))):
        cv2.imwrite(str(tmp_path / f"{number}.png"), rng.integers(0, 255, shape, np.uint8))
    (tmp_path / "notes.txt").write_text("no picture")
    read = pictures.read_pictures(tmp_path)
    assert [picture.shape for picture in read] == [(720, 880)] * 3
    assert all(picture.dtype == np.float32 for picture in read)
    np.testing.assert_array_equal(read[2], cv2.imread(str(tmp_path / "2.png"), cv2.IMREAD_GRAYSCALE))


@pytest.mark.parametrize(
    ("content", "text"), [(None, "no such folder"), ({}, "no pictures"), ({"a.png": b"x"}, "a.png")]
)
def test_pictures_that_are_none_are_told(tmp_path, capsys, content, text):
    folder = tmp_path / "own"
    if content is not None:
        folder.mkdir()
        for name, data in content.items():
            (folder / name).write_bytes(data)
    with pytest.raises(StationError, match=text):
        pictures.read_pictures(folder)
    assert main(["--images", str(folder), "--out", str(tmp_path / "out")]) == 2
    assert text in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("arguments", [["--seed", "-1"], ["--seed", "x"], ["--seed", str(2**31)], ["--nonsense"]])
def test_wrong_usage(arguments, tmp_path, capsys):
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_one_sentence(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["--out", str(tmp_path / "file" / "out")]) == 1
    assert "Traceback" not in capsys.readouterr().err


def test_without_matplotlib_one_sentence_names_the_extra():
    call = (
        "import sys; sys.modules['matplotlib'] = None\n"
        "from base_station.evaluation.thesis.reproduce import main\n"
        "sys.exit(main(['--quick', '--out', '/nonexistent/out']))"
    )
    finished = subprocess.run([sys.executable, "-c", call], capture_output=True, text=True, timeout=60)
    assert finished.returncode == 1
    assert "zservo[figures]" in finished.stderr and "Traceback" not in finished.stderr
