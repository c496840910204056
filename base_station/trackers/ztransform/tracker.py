"""The Z-transform tracker: predict, refine, judge; search when lost.

INITIALIZING until something is learned. TRACKING as long as the signature at the refined placement resembles the
learned one. When it does not, the same frame is searched in wider circles; when that does not help either: LOST, with
what probably happened, and a search of every further frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from base_station.geometry import PinholeCamera
from base_station.trackers.ztransform.acquisition import Acquisition, AcquisitionSettings
from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH, X, Y
from base_station.trackers.ztransform.motion import Motion
from base_station.trackers.ztransform.outline import left_side, lens_of, outline, place_placement, to_pixel
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.refinement import refine
from base_station.trackers.ztransform.regression import RegressionSettings, learn_maps
from base_station.trackers.ztransform.signature import SignatureReader, SignatureSettings
from base_station.trackers.ztransform.texture import texture_of
from base_station.trackers.ztransform.viewing import view_angle_rad
from base_station.types import Box, Frame, TrackerResult, TrackingState


@dataclass(frozen=True, kw_only=True)
class ZTransformSettings:
    """When to believe, and the settings of the stages."""

    keep_confidence: float = 0.35
    """While tracking, a resemblance below this is not the target, however slowly it came to look so."""
    regain_confidence: float = 0.72
    """After it was lost, a resemblance below this is not the target yet."""
    keep_of_usual: float = 0.6
    """While tracking, a resemblance below this share of the usual is not the target: what vanishes does so suddenly."""
    linger_s: float = 0.5
    """After a loss, for so long it is also looked for where it was, on the terms of tracking."""
    surprise: float = 0.12
    """A resemblance by this much below the usual is looked into: perhaps the true place is another."""
    beyond_doubt: float = 0.85
    """A resemblance at which a search needs not look at further candidates."""
    aspects: tuple[float, float] = (0.5, 1.3)
    """Width against height, both against the learned ones: a picture that turned by 60 degrees is half as wide. What
    looks flatter or wider is the refinement squeezing itself into what is left of a target that is being covered."""
    least_share: float = 0.35
    """Of the target that must lie in the frame."""
    least_texture: float = 1.5
    """Grey levels; a view with less is featureless."""
    smallest_side_px: float = 10.0
    """Of the target, to be learned or tracked."""
    largest_share: float = 3.0
    """Of the frame's width; a target that looks wider than that is too near."""
    place_zooms: tuple[float, float] = (0.8, 1.25)
    """A learned place is searched for in this range only."""
    tolerance: float = 0.001
    """In target widths: refining ends when a step is smaller."""
    signature: SignatureSettings = field(default_factory=SignatureSettings)
    """How a patch is read."""
    regression: RegressionSettings = field(default_factory=RegressionSettings)
    """How its changes are learned."""
    acquisition: AcquisitionSettings = field(default_factory=AcquisitionSettings)
    """How it is searched for."""


ROW_SHIFTS = (0.2, -0.2, 0.4, -0.4, 0.6, -0.6)
"""In target heights. While lost, every frame looks about one other row, so that searching them all costs no more."""
USUAL_RATE = 0.05
"""Of the running mean of confidences, per frame."""


@dataclass(frozen=True)
class _Look:
    """What refining from one start gave."""

    placement: np.ndarray
    confidence: float
    share: float


@dataclass(frozen=True)
class _Learned:
    """What `learn` keeps."""

    placement: np.ndarray
    patch: np.ndarray
    signature: np.ndarray
    maps: np.ndarray
    shape: tuple[int, int]
    is_place: bool


_FOLLOW = np.array([1, 2, 2, 2])
_WIDER = np.array([0, 1, 2, 2])
_FROM_SEARCH = np.array([1, 1, 2, 2])
_FREE = np.array([1.0, 1.0, 1.0, 1.0, 1.0])
_FREE_PLACE = np.array([1.0, 1.0, -1.0, 1.0, 0.0])


class ZTransformTracker:
    """Follows a picture or the back of a robot, or holds the heading to a place. Source: Khalil 2021, section 3.3."""

    def __init__(self, *, settings: ZTransformSettings | None = None) -> None:
        self._settings = settings or ZTransformSettings()
        self._reader = SignatureReader(self._settings.signature)
        self._acquisition = Acquisition(self._settings.acquisition)
        cells = self._reader.cells
        self._patch, self._seen = np.empty((cells, cells), np.float32), np.empty((cells, cells), np.uint8)
        self._signature = np.empty(self._reader.size, np.float32)
        self._learned: _Learned | None = None
        self._motion = Motion()
        self._is_tracking, self._usual_confidence, self._frames_lost = False, 0.0, 0
        self._warm_up()

    def learn(self, frame: Frame, target: Box | None) -> None:
        """Remember the target or place. Raises ValueError as `base.Tracker.learn` does."""
        settings, pyramid, lens = self._settings, Pyramid(frame.image), lens_of(frame.camera, curved=target is None)
        if target is None:
            placement = place_placement(frame.camera)
        else:
            self._check(target, frame.image.shape)
            x, y = target.center_px
            placement = np.array([x, y, target.width, target.height, 0.0])
        patch, _, share = self._reader.patch(pyramid, placement, lens)
        if share < settings.least_share:
            raise ValueError(f"only {share:.0%} of the box is inside of the frame")
        texture = texture_of(patch, 1)
        if texture < settings.least_texture:
            raise ValueError(f"featureless: the target's texture is {texture:.1f} grey levels")
        self._learned = _Learned(
            placement,
            patch,
            self._reader.signature(patch)[0],
            learn_maps(pyramid, placement, lens, self._reader, settings.regression),
            frame.image.shape,
            target is None,
        )
        self._acquisition.learn(pyramid.image, placement, lens)
        self._motion.start(placement, frame.time_s)
        self._is_tracking, self._usual_confidence, self._frames_lost = True, 1.0, 0

    def update(self, frame: Frame) -> TrackerResult:
        """See `base.Tracker.update`."""
        learned = self._learned
        if learned is None:
            return TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned yet")
        if frame.image.shape != learned.shape:
            (rows, columns), (old_rows, old_columns) = frame.image.shape, learned.shape
            return _lost(f"the frame is {columns}x{rows}, learned in {old_columns}x{old_rows}", 0.0)
        lens = lens_of(frame.camera, curved=learned.is_place)
        pyramid = Pyramid(frame.image)
        look, is_believed = self._look(pyramid, frame.time_s, lens)
        if is_believed and self._is_possible(look, frame.image.shape):
            return self._tracked(frame, look, lens)
        self._is_tracking = False
        self._frames_lost += 1
        return _lost(self._why(frame, look), look.confidence)

    def close(self) -> None:
        """Let go of what was learned."""
        self._learned = None

    def _look(self, pyramid: Pyramid, time_s: float, lens: np.ndarray) -> tuple[_Look, bool]:
        """The best that can be made of this frame, and whether to believe that it is the target."""
        settings, followed, kept = self._settings, None, False
        if self._is_tracking or self._motion.age_s(time_s) < settings.linger_s:
            followed = self._follow(pyramid, time_s, lens)
            kept = followed.confidence >= max(settings.keep_confidence, settings.keep_of_usual * self._usual_confidence)
            if kept and followed.confidence >= self._usual_confidence - 2 * settings.surprise:
                return followed, True
        found = self._search(pyramid, lens)
        if found.confidence >= settings.regain_confidence and (not followed or found.confidence > followed.confidence):
            return found, True
        if followed:
            return followed, kept
        return found, False

    def _follow(self, pyramid: Pyramid, time_s: float, lens: np.ndarray) -> _Look:
        """Refine from the prediction; if it looks worse than usual, from further afield."""
        predicted = self._motion.predict(time_s)
        best = self._refine(pyramid, predicted, lens, _FOLLOW)
        for start in (predicted, self._motion.last):
            if best.confidence < max(self._usual_confidence - self._settings.surprise, self._settings.keep_confidence):
                best = _better(best, self._refine(pyramid, start, lens, _WIDER))
        return best

    def _search(self, pyramid: Pyramid, lens: np.ndarray) -> _Look:
        """Acquisition, its candidates refined; the best of them, which may not be good enough to be believed."""
        assert self._learned is not None
        zooms = self._settings.place_zooms if self._learned.is_place else None
        best = _Look(self._motion.last, 0.0, 0.0)
        turn = self._frames_lost % (len(ROW_SHIFTS) + 1)
        rows = {"row_shift": ROW_SHIFTS[turn - 1]} if turn else {"row": float(self._motion.last[Y])}
        for candidate in self._acquisition.find(pyramid.image, lens, zooms=zooms, **rows):
            best = _better(best, self._refine(pyramid, candidate.placement, lens, _FROM_SEARCH))
            if best.confidence > self._settings.beyond_doubt:
                break
        return best

    def _refine(self, pyramid: Pyramid, start: np.ndarray, lens: np.ndarray, levels: np.ndarray) -> _Look:
        learned = self._learned
        assert learned is not None
        placement = start.copy()
        confidence, share, _ = refine(
            *self._reader.source(pyramid, start), lens, placement, learned.patch, learned.signature, learned.maps,
            levels, _FREE_PLACE if learned.is_place else _FREE, self._settings.tolerance,
            self._patch, self._seen, self._signature, *self._reader.plan,
        )  # fmt: skip
        aspect = placement[WIDTH] / placement[HEIGHT] * learned.placement[HEIGHT] / learned.placement[WIDTH]
        low, high = self._settings.aspects
        return _Look(placement, float(confidence) if low <= aspect <= high else 0.0, float(share))

    def _is_possible(self, look: _Look, shape: tuple[int, int]) -> bool:
        p, settings = look.placement, self._settings
        return bool(
            look.share >= settings.least_share
            and min(p[WIDTH], p[HEIGHT]) >= settings.smallest_side_px
            and p[WIDTH] <= settings.largest_share * shape[1]
        )

    def _tracked(self, frame: Frame, look: _Look, lens: np.ndarray) -> TrackerResult:
        learned = self._learned
        assert learned is not None
        p = look.placement
        if self._is_tracking:
            self._motion.observe(p, frame.time_s)
            self._usual_confidence += USUAL_RATE * (look.confidence - self._usual_confidence)
        else:
            self._motion.start(p, frame.time_s)
            self._usual_confidence = look.confidence
        self._is_tracking, self._frames_lost = True, 0
        x, y = to_pixel(p[X], p[Y], lens)
        x0, y0 = to_pixel(learned.placement[X], learned.placement[Y], lens)
        return TrackerResult(
            state=TrackingState.TRACKING,
            shift_px=x - x0,
            shift_y_px=y - y0,
            bearing_rad=frame.camera.bearing_rad(x),
            elevation_rad=frame.camera.elevation_rad(y),
            zoom=float(p[HEIGHT] / learned.placement[HEIGHT]),
            view_angle_rad=None if learned.is_place else view_angle_rad(p, learned.placement, lens),
            confidence=min(max(look.confidence, 0.0), 1.0),
            box=outline(p, lens),
        )

    def _why(self, frame: Frame, look: _Look) -> str:
        """What probably happened, in words."""
        settings, (rows, columns) = self._settings, frame.image.shape
        texture = texture_of(frame.image, max(1, columns // 32))
        if texture < settings.least_texture:
            return f"featureless: the view's texture is {texture:.1f} grey levels"
        ahead = self._motion.predict(frame.time_s)
        side = left_side(ahead, columns, rows)
        if side:
            return f"the target left the frame at the {side}"
        if min(ahead[WIDTH], ahead[HEIGHT]) < settings.smallest_side_px * 1.1:
            return f"too small: {ahead[WIDTH]:.0f}x{ahead[HEIGHT]:.0f} px"
        if ahead[WIDTH] > 0.9 * settings.largest_share * columns:
            return f"too large: {ahead[WIDTH]:.0f} px wide"
        return f"the target is hidden or gone (confidence {max(look.confidence, 0.0):.2f})"

    def _check(self, target: Box, shape: tuple[int, int]) -> None:
        rows, columns = shape
        if target.clipped(columns, rows) is None:
            raise ValueError("the box is outside of the frame")
        smallest = self._settings.smallest_side_px
        if min(target.width, target.height) < smallest:
            raise ValueError(f"the target is too small: {target.width:.0f}x{target.height:.0f} px")

    def _warm_up(self) -> None:
        """Compile (or load) the kernels now, on a small made-up picture, so that the first frames are not late."""
        picture = np.random.default_rng(0).integers(0, 255, (48, 64), np.uint8)
        frame = Frame(image=picture, number=1, time_s=0.0, camera=PinholeCamera.with_fov(64, 48))
        few = RegressionSettings(samples=8)
        kept, self._settings = self._settings, ZTransformSettings(least_texture=0, regression=few)
        self.learn(frame, Box(40, 8, 32, 32))
        self.update(frame)
        self._is_tracking = False
        self.update(frame)
        self._settings, self._learned = kept, None


def _better(one: _Look, other: _Look) -> _Look:
    return other if other.confidence > one.confidence else one


def _lost(reason: str, confidence: float) -> TrackerResult:
    return TrackerResult(state=TrackingState.LOST, reason=reason, confidence=min(max(confidence, 0.0), 1.0))
