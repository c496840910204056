"""The Z-transform tracker: predict, refine, judge; search when lost.

INITIALIZING until something is learned. TRACKING as long as the signature at the refined placement resembles the
learned one. When it does not, the same frame is searched in wider circles; when that does not help either: LOST, with
what probably happened, and a search of every further frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from base_station.geometry import PinholeCamera
from base_station.trackers.base import Shown, SignatureView
from base_station.trackers.ztransform.kernels import HEIGHT, KEYSTONE, WIDTH, X, Y
from base_station.trackers.ztransform.landmark_file import LANDMARK_BYTES
from base_station.trackers.ztransform.loose import LooseFollower
from base_station.trackers.ztransform.motion import Motion
from base_station.trackers.ztransform.outline import lens_of, outline, place_placement, to_pixel
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.reasons import check_box, pixel_texture, why_lost
from base_station.trackers.ztransform.recollection import Recollection
from base_station.trackers.ztransform.regression import RegressionSettings
from base_station.trackers.ztransform.rigid import Look, RigidFollower
from base_station.trackers.ztransform.settings import ZTransformSettings
from base_station.trackers.ztransform.texture import texture_of
from base_station.trackers.ztransform.viewing import view_angle_rad
from base_station.types import Box, Frame, TrackerResult, TrackingState

USUAL_RATE = 0.05
"""Of the running mean of confidences, per frame."""
LINGER_FRAMES = 15
"""A loose target that was lost is looked for where it was for so long, then around there too."""
ROOM, ROOM_PX = 0.06, 6.0
"""Of a target's height, and in px: how far it may move up or down, or grow, until the next band comes."""
RING = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1))


@dataclass(frozen=True)
class _Learned:
    """What `learn` keeps besides the followers'."""

    placement: np.ndarray
    shape: tuple[int, int]
    horizon_px: float
    is_place: bool


class ZTransformTracker:
    """Follows a picture or the back of a robot, or holds the heading to a place. Source: Khalil 2021, section 3.3."""

    def __init__(self, *, settings: ZTransformSettings | None = None) -> None:
        self._settings = settings or ZTransformSettings()
        self._rigid, self._loose = RigidFollower(self._settings.rigid), LooseFollower(self._settings.loose)
        self._recollection = Recollection(self._loose, self._settings.recollection)
        self._learned: _Learned | None = None
        self._motion = Motion()
        self._seen: tuple[Pyramid, np.ndarray] | None = None
        """The last frame with the target in it, and its lens."""
        self._is_tracking, self._usual_confidence, self._frames_lost = False, 0.0, 0
        self._candidate: np.ndarray | None = None
        """Where a loose target perhaps was in the frame before: to be confirmed."""
        self._warm_up()

    def learn(self, frame: Frame, target: Box | None) -> None:
        """Remember the target or place. Raises ValueError as `base.Tracker.learn` does."""
        settings, pyramid, lens = self._settings, Pyramid(frame.image), lens_of(frame.camera, curved=target is None)
        if target is None:
            placement = place_placement(frame.camera)
        else:
            check_box(target, frame.image.shape, self._settings)
            x, y = target.center_px
            placement = np.array([x, y, target.width, target.height, 0.0])
        patch, share = self._rigid.read(pyramid, placement, lens)
        if share < settings.least_share:
            raise ValueError(f"only {share:.0%} of the box is inside of the frame")
        texture = min(texture_of(patch, 1), pixel_texture(frame, target, self._settings))
        if texture < settings.least_texture:
            raise ValueError(f"featureless: the target's texture is {texture:.1f} grey levels above the noise")
        self._learned = _Learned(placement, frame.shape, frame.camera.cy, target is None)
        self._rigid.learn(pyramid, placement, lens, is_place=target is None)
        if target is not None:
            self._loose.start(pyramid, placement)
            self._recollection.start()
        self._motion.start(placement, frame.time_s)
        self._candidate = None
        self._is_tracking, self._usual_confidence, self._frames_lost = True, 1.0, 0
        self._is_loose, self._frames_firm, self._firm_s, self._frames = False, 0, frame.time_s, 0

    def expect(self, placement: np.ndarray, time_s: float) -> None:
        """The learned target is about here now, says who recognised it, and keeps its shape. See `kernels`."""
        self._motion.start(placement, time_s)
        self._candidate = None
        self._is_tracking, self._usual_confidence, self._frames_lost = True, 1.0, 0
        self._is_loose, self._frames_firm, self._firm_s = False, self._settings.proven_frames, time_s

    def update(self, frame: Frame) -> TrackerResult:
        """See `base.Tracker.update`."""
        learned, self._seen = self._learned, None
        if learned is None:
            return TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned yet")
        shape = frame.shape
        if shape != learned.shape:
            (rows, columns), (old_rows, old_columns) = shape, learned.shape
            return _lost(f"the frame is {columns}x{rows}, learned in {old_columns}x{old_rows}", 0.0)
        lens = lens_of(frame.camera, curved=learned.is_place)
        pyramid = Pyramid(frame.image, frame.first_row)
        look, is_believed = self._look(pyramid, frame.time_s, lens, is_whole=frame.is_whole)
        if is_believed and self._is_possible(look, shape):
            self._seen = pyramid, lens
            return self._tracked(frame, look, lens)
        self._is_tracking = False
        self._frames_lost += 1
        ahead = self._motion.predict(frame.time_s)
        return _lost(why_lost(frame, ahead, look.confidence, self._settings), look.confidence)

    def wanted_rows(self) -> tuple[int, int] | None:
        """See `base.WantsRows`. All, unless the target is proven rigid and seen firm: searching needs the whole frame,
        and so does learning what surrounds the target."""
        learned, p = self._learned, self._motion.last
        if learned is None or learned.is_place or not (self._is_tracking and self._is_proven and self._was_firm):
            return None
        reach = p[HEIGHT] / 2 * (1 + ROOM) + ROOM_PX
        nearer = 1 / (1 - abs(p[KEYSTONE]) / 2)  # one side of a picture seen aslant is taller
        ends = [p[Y] + side * reach for side in (-1, 1)]
        ends += [learned.horizon_px + nearer * (y - learned.horizon_px) for y in ends]
        return math.floor(min(ends)), math.ceil(max(ends)) + 1

    def show(self) -> Shown:
        """See `base.Shows`."""
        return Shown(bands=self._settings.rigid.signature.bands)

    def show_signature(self) -> SignatureView | None:
        """See `base.Signs`."""
        if self._seen is None or self._learned is None:
            return None
        pyramid, lens = self._seen
        now, learned = self._rigid.signatures(pyramid, self._motion.last, lens)
        return SignatureView(now=now, learned=learned)

    @property
    def landmark_bytes(self) -> int:
        """What must be kept to find what was learned again: a `Landmark`. `recall.py` makes a tracker of one."""
        return LANDMARK_BYTES if self._learned is not None else 0

    def close(self) -> None:
        """Let go of what was learned."""
        self._learned = self._seen = None

    def _look(self, pyramid: Pyramid, time_s: float, lens: np.ndarray, *, is_whole: bool = True) -> tuple[Look, bool]:
        """The best that can be made of this frame, and whether to believe that it is the target."""
        assert self._learned is not None
        settings, followed, is_firm = self._settings, None, False
        self._frames += 1
        near = self._is_tracking or self._motion.age_s(time_s) < settings.linger_s
        if near and not (self._is_loose and self._frames % settings.rigid_every):
            followed = self._follow(pyramid, time_s, lens)
            is_firm = self._is_firm(followed)
            if is_firm and self._is_loose:
                is_firm = is_whole and self._is_agreed(pyramid, followed)
            if is_firm and followed.confidence >= self._usual_confidence - 2 * settings.surprise:
                self._seen_firm(pyramid, followed, time_s, is_whole=is_whole)
                return followed, True
        if not is_whole:  # a search needs all of the frame, and once the target is lost that is what comes
            look = followed or Look(self._motion.last, 0.0, 0.0)
            return look, not self._is_loose and self._is_kept(look)
        if self._is_loose:
            loose = self._follow_loose(pyramid, time_s)
            loose = self._recollected(pyramid, loose) or loose
            if loose is not None:
                return loose, True
            if self._is_tracking or self._frames_lost % settings.lost_search_every:
                return Look(self._motion.last, 0.0, 0.0), False
        if followed and self._is_as_usual(followed) and self._frames % settings.search_every:
            return followed, True
        just_seen = self._is_tracking and self._motion.age_s(time_s) < settings.linger_s
        found = self._rigid.search(pyramid, lens, self._motion.last, self._frames_lost, just_seen=just_seen)
        least = max(settings.regain_confidence, followed.confidence if followed else 0.0)
        if found.confidence >= least and self._is_agreed(pyramid, found):
            self._seen_firm(pyramid, found, time_s)
            return found, True
        if followed and is_firm:
            self._seen_firm(pyramid, followed, time_s)
            return followed, True
        if not (self._learned.is_place or self._is_loose) and (near or not self._is_proven):
            loose = self._follow_loose(pyramid, time_s)
            if loose is not None:
                return loose, True
        if followed:
            return followed, self._is_kept(followed)
        return found, False

    @property
    def _is_proven(self) -> bool:
        return self._frames_firm >= self._settings.proven_frames

    @property
    def _was_firm(self) -> bool:
        """It was when it was seen last."""
        return self._motion.age_s(self._firm_s) >= 0

    def _is_kept(self, look: Look) -> bool:
        """Tracking goes on with this look for want of a better one."""
        settings, learned = self._settings, self._learned
        assert learned is not None
        least = max(settings.keep_confidence, settings.keep_of_usual * self._usual_confidence)
        if not (learned.is_place or self._is_proven):
            least = max(least, settings.regain_confidence)
        return look.confidence >= least

    def _is_as_usual(self, look: Look) -> bool:
        """A proven target that is not firm, and has not been for a while: a search would hardly tell more."""
        settings = self._settings
        least = max(settings.regain_confidence, self._usual_confidence - settings.surprise / 2)
        return self._is_tracking and self._is_proven and look.share == 1 and look.confidence >= least

    def _is_firm(self, look: Look) -> bool:
        """The signature alone is enough."""
        settings, learned = self._settings, self._learned
        assert learned is not None
        if learned.is_place:
            return self._is_kept(look)
        if self._is_proven or look.confidence < settings.firm:
            return look.confidence >= settings.firm
        aspect = look.placement[WIDTH] / look.placement[HEIGHT] * learned.placement[HEIGHT] / learned.placement[WIDTH]
        low, high = settings.firm_aspects
        return bool(low <= aspect <= high)

    def _is_agreed(self, pyramid: Pyramid, look: Look) -> bool:
        """The loose follower sees the target there too: the two err differently."""
        assert self._learned is not None
        if self._learned.is_place:
            return True
        return look.confidence >= self._settings.needs_no_second or self._loose.resembles(pyramid, look.placement)

    def _follow(self, pyramid: Pyramid, time_s: float, lens: np.ndarray) -> Look:
        """The signature, from where the target should be now."""
        enough = max(self._usual_confidence - self._settings.surprise, self._settings.keep_confidence)
        return self._rigid.follow(pyramid, lens, self._motion.predict(time_s), self._motion.last, enough)

    def _seen_firm(self, pyramid: Pyramid, look: Look, time_s: float, *, is_whole: bool = True) -> None:
        """The signature was seen; now and then the loose follower learns how the target looks there, and around it."""
        assert self._learned is not None
        settings = self._settings
        self._is_loose, self._firm_s, self._candidate = False, time_s, None
        self._recollection.start()
        if look.confidence < settings.firm or self._learned.is_place:
            return
        self._frames_firm += 1
        covered = not is_whole or look.share < 1 or look.alike < settings.uncovered
        if covered or (self._is_proven and self._frames % settings.loose_every):
            return
        self._loose.upright()
        if self._loose.look(pyramid, look.placement).sharpness >= settings.loose.least_sharpness:
            self._loose.adapt(pyramid, settings.loose_times if self._is_proven else 1)

    def _follow_loose(self, pyramid: Pyramid, time_s: float) -> Look | None:
        """The target by what it looked like lately, or None. It goes on learning once it is taken for loose."""
        settings, start = self._settings, self._motion.last.copy()
        start[KEYSTONE] = 0.0
        if self._candidate is not None:
            start = self._candidate
        elif self._frames_lost > LINGER_FRAMES:
            side = settings.loose.window / 2 * float(np.sqrt(start[WIDTH] * start[HEIGHT]))
            dx, dy = ((0, 0), *RING)[self._frames_lost % (len(RING) + 1)]
            start[X] += dx * side
            start[Y] += dy * side
        sighting = self._loose.look(pyramid, start)
        confirming = self._candidate is not None
        near = (confirming or self._is_tracking) and _is_near(sighting.placement, start, settings.near)
        least = settings.loose.least_sharpness
        needed = settings.far_sharpness if not near else settings.again_sharpness if confirming else least
        clear = sighting.sharpness >= needed
        self._candidate = sighting.placement if least <= sighting.sharpness < needed else None
        if not clear:
            held = self._is_loose and near and not confirming
            if not held or sighting.sharpness < settings.hold_sharpness:
                return None
            if _share_inside(sighting.placement, pyramid.image.shape) < settings.hold_share:
                return None
        proven = self._is_proven and time_s - self._firm_s < settings.reconsider_s
        placement = self._loose.adapt(pyramid) if clear and not proven else sighting.placement
        self._is_loose = not proven
        return self._loose_look(placement, sighting.sharpness)

    def _recollected(self, pyramid: Pyramid, look: Look | None) -> Look | None:
        """Elsewhere the loose target looks as it did when it was learned; what was followed (`look`) does not."""
        placement = look.placement if look else self._motion.last
        sighting = self._recollection.look(pyramid, placement, is_seen=look is not None)
        if sighting is None:
            return None
        self._candidate, self._is_tracking = None, False
        return self._loose_look(sighting.placement, sighting.sharpness)

    def _loose_look(self, placement: np.ndarray, sharpness: float) -> Look:
        confidence = sharpness / (sharpness + self._settings.loose.least_sharpness)
        return Look(placement, confidence, 1.0, tells_angle=False)

    def _is_possible(self, look: Look, shape: tuple[int, int]) -> bool:
        (_, _, width, height, _), settings = look.placement.tolist(), self._settings
        return bool(
            look.share >= settings.least_share
            and min(width, height) >= settings.smallest_side_px
            and width <= settings.largest_share * shape[1]
        )

    def _tracked(self, frame: Frame, look: Look, lens: np.ndarray) -> TrackerResult:
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
        (x, y, _, height, _), (x0, y0, _, height0, _) = p.tolist(), learned.placement.tolist()
        if learned.is_place:
            (x, y), (x0, y0) = to_pixel(x, y, lens), to_pixel(x0, y0, lens)
        return TrackerResult(
            state=TrackingState.TRACKING,
            shift_px=x - x0,
            shift_y_px=y - y0,
            bearing_rad=frame.camera.bearing_rad(x),
            elevation_rad=frame.camera.elevation_rad(y),
            zoom=height / height0,
            view_angle_rad=view_angle_rad(p, learned.placement, lens) if look.tells_angle else None,
            confidence=min(max(look.confidence, 0.0), 1.0),
            box=outline(p, lens),
        )

    def _warm_up(self) -> None:
        """Compile (or load) the kernels now, on small made-up pictures, so that the first frames are not late: of the
        target, of something else, and of the target again."""
        picture, other = np.random.default_rng(0).integers(0, 255, (2, 48, 64), np.uint8)
        picture.flags.writeable = other.flags.writeable = False  # as a robot's are: another type to compiled code
        frame = Frame(image=picture, number=1, time_s=0.0, camera=PinholeCamera.with_fov(64, 48))
        few = replace(self._settings.rigid, regression=RegressionSettings(samples=8))
        kept = self._settings, self._rigid
        self._settings, self._rigid = ZTransformSettings(least_texture=0), RigidFollower(few)
        self.learn(frame, Box(40, 8, 32, 32))
        self.update(frame)
        self.update(replace(frame, image=other))
        self._is_tracking = False
        self.update(frame)
        self._follow_loose(Pyramid(picture), 0.0)
        (self._settings, self._rigid), self._learned, self._seen = kept, None, None


def _lost(reason: str, confidence: float) -> TrackerResult:
    return TrackerResult(state=TrackingState.LOST, reason=reason, confidence=min(max(confidence, 0.0), 1.0))


def _is_near(placement: np.ndarray, start: np.ndarray, sides: float) -> bool:
    """The placement's middle is at most so many sides of the target from the start's."""
    (x, y, width, height, _), (x0, y0, _, _, _) = placement.tolist(), start.tolist()
    return math.hypot(x - x0, y - y0) <= sides * math.sqrt(width * height)


def _share_inside(placement: np.ndarray, shape: tuple[int, ...]) -> float:
    """Of an upright target that lies in a frame of this shape."""
    box = Box.around(*(float(v) for v in placement[[X, Y, WIDTH, HEIGHT]]))
    inside = box.clipped(shape[1], shape[0])
    return inside.width * inside.height / (box.width * box.height) if inside else 0.0
