"""Whether a landmark is where the shortlist says: refined by its own small map, and judged by the full signature."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from base_station.trackers.ztransform.kernels import inner
from base_station.trackers.ztransform.landmark import BOX_CELLS, CELLS, Landmark
from base_station.trackers.ztransform.poles import PoleSettings
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.refinement import refine
from base_station.trackers.ztransform.regression import Disturbance, RegressionSettings, learn_maps
from base_station.trackers.ztransform.signature import SignatureReader, SignatureSettings

SMALL = SignatureSettings(
    cells=24,
    bands=2,
    anchors=3,
    spread=0.6,
    poles=PoleSettings(count=4, longest_cells=6.0, shortest_cells=1.2),
    is_compact=False,  # landmark files hold maps of these numbers
)
SMALL_SIZE = SignatureReader(SMALL).size
SMALL_REGRESSION = RegressionSettings(
    levels=(Disturbance(shift=0.12, log_zoom=0.12, log_aspect=0.06, keystone=0.06),), samples=250
)
_BOX = slice((CELLS - BOX_CELLS) // 2, (CELLS + BOX_CELLS) // 2)
_FREE, _FREE_PLACE = np.array([1.0, 1.0, 1.0, 1.0, 1.0]), np.array([1.0, 1.0, -1.0, 1.0, 0.0])


@dataclass(frozen=True, kw_only=True)
class VerificationSettings:
    """When to believe that it is the landmark."""

    steps: int = 2
    """Of refinement, at most; four find less, since the map is a coarse one."""
    tolerance: float = 0.002
    """In widths: a step smaller than this is the last."""
    worth_a_look: float = 0.6
    """Confidence on the small signature from which the full one is read."""
    confidence: float = 0.8
    """Believed from here on."""
    least_share: float = 0.6
    """Of a landmark that must lie in the frame."""


@dataclass(frozen=True)
class Known:
    """What is made of a landmark once, to verify it quickly; 21 kB."""

    is_place: bool
    small_patch: np.ndarray
    small_signature: np.ndarray
    maps: np.ndarray
    """float32 (1, 5, numbers)."""
    patch: np.ndarray
    signature: np.ndarray


class Verifier:
    """Refines and judges. Knows no landmark of its own."""

    def __init__(self, settings: VerificationSettings) -> None:
        self._settings = settings
        self._small, self._full = SignatureReader(SMALL), SignatureReader(SignatureSettings())
        self._turns = np.zeros(settings.steps, np.int64)

    def learn(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> np.ndarray:
        """A landmark's map, float16 (5, numbers), see `regression`."""
        return learn_maps(pyramid, placement, lens, self._small, SMALL_REGRESSION)[0].astype(np.float16)

    def known(self, landmark: Landmark) -> Known:
        """Make it ready."""
        patch, cells = box_of(landmark.picture).astype(np.float32), (SMALL.cells, SMALL.cells)
        small = cv2.resize(box_of(landmark.picture), cells, interpolation=cv2.INTER_AREA).astype(np.float32)
        return Known(
            is_place=landmark.box is None,
            small_patch=small,
            small_signature=self._small.signature(small)[0],
            maps=landmark.step_map.astype(np.float32)[None],
            patch=patch,
            signature=self._full.signature(patch)[0],
        )

    def verify(
        self, pyramid: Pyramid, known: Known, lens: np.ndarray, start: np.ndarray
    ) -> tuple[np.ndarray, float] | None:
        """The placement, refined from `start`, and the confidence 0..1. None unless both signatures agree there."""
        settings, placement = self._settings, start.copy()
        confidence, share = refine(
            *self._small.source(pyramid, placement, lens, whole=True), lens, placement, known.small_patch,
            known.small_signature, known.maps, self._turns, _FREE_PLACE if known.is_place else _FREE,
            settings.tolerance, *self._small.plan,
        )  # fmt: skip
        if confidence < settings.worth_a_look or share < settings.least_share:
            return None
        confidence = float(inner(self._full.read(pyramid, placement, lens, known.patch), known.signature))
        return (placement, min(confidence, 1.0)) if confidence >= settings.confidence else None


def box_of(picture: np.ndarray) -> np.ndarray:
    """Of a landmark's small picture the part that shows the box."""
    return picture[_BOX, _BOX]
