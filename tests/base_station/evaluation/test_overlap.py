"""Overlap scores with known answers, and the files they are read from."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.errors import StationError
from base_station.evaluation.overlap import read_results, read_truth, score_boxes

BOX = (10.0, 20.0, 40.0, 30.0)
NO_BOX = (np.nan,) * 4


def score(found, truth):
    return score_boxes(np.array(found, float), np.array(truth, float))


def test_the_same_boxes_overlap_wholly():
    """The area is 20/21 as in OTB: no overlap exceeds the last threshold, 1."""
    result = score([BOX] * 4, [BOX] * 4)
    assert (result.frames, result.boxes, result.mean_iou, result.precision20) == (4, 4, 1.0, 1.0)
    assert result.auc == pytest.approx(20 / 21)


def test_half_a_box_aside_overlaps_by_a_third():
    aside = (BOX[0] + BOX[2] / 2, *BOX[1:])
    result = score([aside], [BOX])
    assert result.mean_iou == pytest.approx(1 / 3)
    assert result.auc == pytest.approx(7 / 21)  # thresholds 0, 0.05 .. 0.3


def test_a_box_within_a_box_overlaps_by_the_ratio_of_areas():
    assert score([(10, 20, 20, 15)], [BOX]).mean_iou == pytest.approx(0.25)


def test_boxes_apart_do_not_overlap_whichever_side_they_are_on():
    for aside in ((-100, 20, 40, 30), (100, 20, 40, 30), (10, -100, 40, 30), (-90, -90, 40, 30)):
        result = score([aside], [BOX])
        assert (result.mean_iou, result.auc, result.precision20) == (0.0, 0.0, 0.0)


def test_precision_is_the_share_of_centres_within_20_px():
    def moved(dx: float, dy: float) -> tuple[float, ...]:
        return BOX[0] + dx, BOX[1] + dy, BOX[2], BOX[3]

    assert score([moved(12, 16), moved(12, 16.1), moved(0, 0), moved(20, 0)], [BOX] * 4).precision20 == 0.75
    grown = (BOX[0] - 30, BOX[1] - 30, BOX[2] + 60, BOX[3] + 60)
    assert score([grown], [BOX]).precision20 == 1.0  # the same centre


def test_a_frame_without_a_box_overlaps_by_nothing_but_counts():
    result = score([BOX, NO_BOX], [BOX, BOX])
    assert (result.frames, result.boxes, result.mean_iou, result.precision20) == (2, 1, 0.5, 0.5)
    assert result.auc == pytest.approx(10 / 21)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e300, -1e300])
def test_a_frame_without_a_true_box_is_left_out(wrong):
    box = [10.0, 10.0, 20.0, 20.0]
    found = score_boxes(np.array([box, box, box]), np.array([box, [wrong, 10, 20, 20], [10, 10, 0, 0]]))
    assert (found.frames, found.mean_iou, found.precision20) == (1, 1.0, 1.0)
    with pytest.raises(ValueError, match="no true box"):
        score_boxes(np.array([box]), np.array([[wrong, 10, 20, 20]]))


@pytest.mark.parametrize("shapes", [((2, 4), (3, 4)), ((2, 3), (2, 3)), ((0, 4), (0, 4)), ((4,), (4,))])
def test_boxes_that_do_not_match_in_number_are_refused(shapes):
    with pytest.raises(ValueError, match="both must be"):
        score_boxes(np.zeros(shapes[0]), np.zeros(shapes[1]))


@pytest.mark.parametrize(
    "text", ["1,2,3,4\n5,6,7,8\n", "1\t2\t3\t4\n5 6  7 8", "1, 2, 3, 4\r\n\r\n5,6,7,8.0\r\n", "\ufeff1,2,3,4\n5,6,7,8"]
)
def test_truth_is_read_whatever_parts_the_numbers(tmp_path, text):
    (tmp_path / "truth.txt").write_text(text, encoding="utf-8")
    assert read_truth(tmp_path / "truth.txt").tolist() == [[1, 2, 3, 4], [5, 6, 7, 8]]


@pytest.mark.parametrize("text", ["1,2,3\n", "1,2,3,4\n5,6\n", "1,2,3,x\n", "1,2,3\n4,5,6\n7,8,9\n10,11,12\n"])
def test_a_line_without_four_numbers_is_no_truth(tmp_path, text):
    """The last one has twelve numbers, as three boxes have, in lines of three."""
    (tmp_path / "truth.txt").write_text(text)
    with pytest.raises(StationError, match=r"four numbers a line are expected, line [12] is '"):
        read_truth(tmp_path / "truth.txt")


def test_what_is_no_text_is_told_without_codecs(tmp_path):
    (tmp_path / "truth.txt").write_bytes(bytes(range(256)))
    for read in (read_truth, read_results):
        with pytest.raises(StationError, match="is no text") as caught:
            read(tmp_path / "truth.txt")
        assert "codec" not in str(caught.value)


def test_results_are_read_with_gaps_where_there_was_no_box(tmp_path):
    (tmp_path / "r.csv").write_text("frame,x,y,width,height\n1,1,2,3,4\n2,,,,\n")
    boxes = read_results(tmp_path / "r.csv")
    assert boxes[0].tolist() == [1, 2, 3, 4]
    assert np.isnan(boxes[1]).all()


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "x,y,width,height\n1,2,3,four\n"])
def test_another_file_is_no_results(tmp_path, text):
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(StationError, match="no file written by --results"):
        read_results(tmp_path / "r.csv")


def test_a_missing_file_is_wrong_usage(tmp_path):
    for read in (read_truth, read_results):
        with pytest.raises(StationError, match="cannot be read") as caught:
            read(tmp_path / "nowhere")
        assert caught.value.usage
