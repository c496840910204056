"""Following what keeps its shape, to a fraction of a pixel: predict, refine by the maps, search when need be."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from base_station.trackers.ztransform.acquisition import Acquisition, AcquisitionSettings
from base_station.trackers.ztransform.alignment import Aligner, Alignment, AlignmentSettings
from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH, Y
from base_station.trackers.ztransform.pieces import Pieces, PieceSettings
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.refinement import ENOUGH_SEEN, MORE_TO_READ, refine
from base_station.trackers.ztransform.regression import RegressionSettings, learn_maps
from base_station.trackers.ztransform.signature import SignatureReader, SignatureSettings


@dataclass(frozen=True, kw_only=True)
class RigidSettings:
    """The stages, and when a look is good enough to look no further."""

    aspects: tuple[float, float] = (0.5, 1.3)
    """Width against height, both against the learned ones: a picture that turned by 60 degrees is half as wide. What
    looks flatter or wider is the refinement squeezing itself into what is left of a target that is being covered."""
    beyond_doubt: float = 0.85
    """A resemblance at which a search needs not look at further candidates."""
    place_zooms: tuple[float, float] = (0.8, 1.25)
    """A learned place is searched for in this range only."""
    sudden_zoom: float = 1.5
    """From one frame to the next a target does not get larger or smaller than by this factor."""
    tolerance: float = 0.01
    """In target widths: refining ends when a step is smaller, and settling goes on from there."""
    place_tolerance: float = 0.001
    """The same of a place, which nothing settles."""
    signature: SignatureSettings = field(default_factory=SignatureSettings)
    """How a patch is read."""
    regression: RegressionSettings = field(default_factory=RegressionSettings)
    """How its changes are learned."""
    alignment: AlignmentSettings = field(default_factory=AlignmentSettings)
    """How it is compared, cell by cell."""
    pieces: PieceSettings = field(default_factory=PieceSettings)
    """How it is looked for when a part of it is covered."""
    acquisition: AcquisitionSettings = field(default_factory=AcquisitionSettings)
    """How it is searched for."""


ROW_SHIFTS = (0.2, -0.2, 0.4, -0.4, 0.6, -0.6)
"""In target heights. While lost, every frame looks about one other row, so that searching them all costs no more."""


@dataclass(frozen=True)
class Look:
    """What looking gave. `share`: of the target that lies in the frame; `alike`: of that, what is not covered."""

    placement: np.ndarray
    confidence: float
    share: float
    alike: float = 1.0
    tells_angle: bool = False
    """Width, height and keystone of the placement were measured each for itself."""


_FOLLOW = np.array([1, 2, 2, 2])
_WIDER = np.array([0, 1, 2, 2])
_FROM_SEARCH = np.array([1, 1, 2, 2])
_FREE = np.array([1.0, 1.0, 1.0, 1.0, 1.0])
_FREE_PLACE = np.array([1.0, 1.0, -1.0, 1.0, 0.0])


class RigidFollower:
    """One picture, or one place. `learn` first."""

    def __init__(self, settings: RigidSettings) -> None:
        self._settings = settings
        self._reader = SignatureReader(settings.signature)
        self._acquisition = Acquisition(settings.acquisition)
        self._aligner = Aligner(settings.alignment, self._reader)
        self._pieces = Pieces(settings.pieces, self._reader)

    def read(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> tuple[np.ndarray, float]:
        """The patch at a placement, float32 (cells, cells), and the share of it that lies in the frame."""
        patch, _, share = self._reader.patch(pyramid, placement, lens)
        return patch, share

    def signatures(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """At this placement, and as learned: float32 (n,) of length 1 each."""
        patch, _ = self.read(pyramid, *_in_band(pyramid, placement, lens))
        return self._reader.signature(patch)[0], self._learned_signature

    def learn(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray, *, is_place: bool) -> None:
        """Remember what is at this placement, and how its signature changes when it moves."""
        self._learned_at, self._is_place = placement.copy(), is_place
        self._learned_aspect = float(placement[WIDTH] / placement[HEIGHT])
        self._tolerance = self._settings.place_tolerance if is_place else self._settings.tolerance
        self._learned_patch, _ = self.read(pyramid, placement, lens)
        self._learned_signature, _ = self._reader.signature(self._learned_patch)
        self._maps = learn_maps(pyramid, placement, lens, self._reader, self._settings.regression)
        self._acquisition.learn(pyramid, placement, lens)
        if not is_place:
            self._aligner.learn(pyramid, placement, lens)
            self._pieces.learn(pyramid, placement, lens)

    def follow(
        self, pyramid: Pyramid, lens: np.ndarray, predicted: np.ndarray, last: np.ndarray, enough: float
    ) -> Look:
        """Refine from the prediction; if that looks less like it than `enough`, from further afield. Does so in a band
        of the frame too."""
        best = self._settle_near(pyramid, predicted, lens)
        if best.confidence < enough:
            best = _better(best, self._refine(pyramid, predicted, lens, _FOLLOW))
        for start in (predicted, last):
            if best.confidence < enough:
                best = _better(best, self._refine(pyramid, start, lens, _WIDER))
        if best.confidence < enough and not self._is_place:
            best = _better(best, self._approach(pyramid, predicted, lens))
        return best

    def search(
        self, pyramid: Pyramid, lens: np.ndarray, last: np.ndarray, frames_lost: int, *, just_seen: bool = False
    ) -> Look:
        """Acquisition, its candidates refined; the best of them, which may not be good enough to be believed.

        `just_seen`: at `last`, in the frame before this one.
        """
        zooms = self._settings.place_zooms if self._is_place else None
        if just_seen and not self._is_place:
            settings, sudden = self._settings.acquisition, self._settings.sudden_zoom
            zoom = float(last[HEIGHT] / self._learned_at[HEIGHT])
            zoom = min(max(zoom, settings.smallest_zoom), settings.largest_zoom)
            zooms = max(zoom / sudden, settings.smallest_zoom), min(zoom * sudden, settings.largest_zoom)
        best = Look(last, 0.0, 0.0)
        turn = frames_lost % (len(ROW_SHIFTS) + 1)
        rows = {"row_shift": ROW_SHIFTS[turn - 1]} if turn else {"row": float(last[1])}
        for candidate in self._acquisition.find(pyramid, lens, zooms=zooms, **rows):
            best = _better(best, self._refine(pyramid, candidate.placement, lens, _FROM_SEARCH))
            if best.confidence < self._settings.beyond_doubt and not self._is_place:
                best = _better(best, self._approach(pyramid, candidate.placement, lens))
            if best.confidence > self._settings.beyond_doubt:
                return best
        if not self._is_place:
            best = _better(best, self._approach(pyramid, self._pieces.find(pyramid, last, lens), lens))
        return best

    def _settle_near(self, pyramid: Pyramid, start: np.ndarray, lens: np.ndarray) -> Look:
        """Where a good prediction says: without the signature, which would come to the same."""
        if self._is_place:
            return Look(start, 0.0, 0.0)
        return self._judged(pyramid, self._aligner.settle(pyramid, *_in_band(pyramid, start, lens), is_near=True))

    def _approach(self, pyramid: Pyramid, start: np.ndarray, lens: np.ndarray) -> Look:
        """Without the signature, for it knows no covered parts."""
        return self._judged(pyramid, self._aligner.approach(pyramid, *_in_band(pyramid, start, lens)))

    def _refine(self, pyramid: Pyramid, start: np.ndarray, lens: np.ndarray, levels: np.ndarray) -> Look:
        placement, lens = _in_band(pyramid, start, lens)
        for whole in (False, True):
            source = self._reader.source(pyramid, placement, lens, whole=whole)
            confidence, share = refine(
                *source, lens, placement, self._learned_patch, self._learned_signature, self._maps, levels,
                _FREE_PLACE if self._is_place else _FREE, self._tolerance, *self._reader.plan,
            )  # fmt: skip
            if self._is_place or share < ENOUGH_SEEN:
                found = Alignment(placement, confidence, share, 1.0)
            else:
                found = self._aligner.settle(pyramid, placement, lens)
            if found.share != MORE_TO_READ:
                break
        return self._judged(pyramid, found)

    def _judged(self, pyramid: Pyramid, found: Alignment) -> Look:
        """In the whole frame. What got much flatter or wider than it was learned is not believed."""
        placement = found.placement
        if pyramid.first_row:
            placement[Y] += pyramid.first_row
        aspect = float(placement[WIDTH]) / float(placement[HEIGHT]) / self._learned_aspect
        low, high = self._settings.aspects
        confidence = found.confidence if low <= aspect <= high else 0.0
        return Look(placement, confidence, found.share, alike=found.alike, tells_angle=not self._is_place)


def _better(one: Look, other: Look) -> Look:
    return other if other.confidence > one.confidence else one


def _in_band(pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A copy of the placement, and the lens, counted from the pyramid's first row."""
    if not pyramid.first_row:
        return placement.copy(), lens
    return placement - (0, pyramid.first_row, 0, 0, 0), lens - (0, 0, 0, pyramid.first_row)
