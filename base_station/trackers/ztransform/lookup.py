"""The memory of landmarks: learn them, forget them, and find those that a frame shows, some milliseconds for hundreds.

A shortlist is made of all of them together (`shortlist.py`); each on it is refined by the tracker's own regression on a
small signature (24 cells), and believed if the full one (48 cells) agrees (`verification.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from base_station.geometry import PinholeCamera
from base_station.trackers.ztransform.kernels import HEIGHT
from base_station.trackers.ztransform.landmark import Landmark, box_placement, check_name, small_picture
from base_station.trackers.ztransform.outline import lens_of, outline, place_placement, to_pixel
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.shortlist import Shortlist, ShortlistSettings
from base_station.trackers.ztransform.texture import texture_of
from base_station.trackers.ztransform.verification import Known, VerificationSettings, Verifier, box_of
from base_station.types import Box, Frame

SAME_SPOT = 0.25
"""Of the surer sighting's sides: centres that are nearer are one spot's."""


@dataclass(frozen=True, kw_only=True)
class LookupSettings:
    """What can be learned, and the settings of the stages."""

    least_texture: float = 1.5
    """Grey levels; with less there is nothing to remember."""
    smallest_side_px: float = 24.0
    """Of a target, to be learned as a landmark."""
    shortlist: ShortlistSettings = field(default_factory=ShortlistSettings)
    """What to look for."""
    verification: VerificationSettings = field(default_factory=VerificationSettings)
    """When to believe it."""


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """A landmark that is seen. Angles and zoom as in `TrackerResult`."""

    landmark: Landmark
    confidence: float
    placement: np.ndarray
    """See `kernels`."""
    bearing_rad: float
    elevation_rad: float
    zoom: float
    box: Box


@dataclass(frozen=True)
class _Plan:
    """The landmarks that are looked for, made ready for one camera."""

    camera: PinholeCamera
    lenses: tuple[np.ndarray, np.ndarray]
    """Of targets, of places."""
    only: str | None
    landmarks: list[Landmark]
    shortlist: Shortlist
    known: dict[int, Known]
    """Of those, by number, that were on the shortlist once."""


class LandmarkMemory:
    """Landmarks by name. All of them are looked for together."""

    def __init__(self, settings: LookupSettings | None = None) -> None:
        self._settings = settings or LookupSettings()
        self._verifier = Verifier(self._settings.verification)
        self._landmarks: dict[str, Landmark] = {}
        self._plan: _Plan | None = None

    def __len__(self) -> int:
        return len(self._landmarks)

    @property
    def landmarks(self) -> list[Landmark]:
        """In the order in which they were learned."""
        return list(self._landmarks.values())

    def __getitem__(self, name: str) -> Landmark:
        """Raises KeyError for a name that is not known."""
        return self._landmarks[name]

    def add(self, landmark: Landmark) -> None:
        """Replaces one of the same name."""
        check_name(landmark.name)
        self._landmarks[landmark.name] = landmark
        self._plan = None

    def forget(self, name: str) -> None:
        """Raises KeyError for a name that is not known."""
        del self._landmarks[name]
        self._plan = None

    def learn(self, name: str, frame: Frame, box: Box | None, *, learned_depth_m: float | None = None) -> Landmark:
        """Remember what is in the box, or with None the whole view. Replaces a landmark of the same name.

        Raises ValueError, with the reason in words, when there is nothing there to remember, or the name is none.
        """
        check_name(name)
        curved, camera, pyramid = box is None, frame.camera, Pyramid(frame.image)
        self._check(box, frame)
        placement = place_placement(camera) if box is None else box_placement(box)
        lens = lens_of(camera, curved=curved)
        picture = small_picture(pyramid, placement, camera, curved=curved)
        texture = texture_of(box_of(picture).astype(np.float32), 1)
        if texture < self._settings.least_texture:
            raise ValueError(f"featureless: its texture is {texture:.1f} grey levels")
        landmark = Landmark(
            name=name,
            camera=camera,
            box=box,
            picture=picture,
            step_map=self._verifier.learn(pyramid, placement, lens),
            learned_depth_m=learned_depth_m,
        )
        self.add(landmark)
        return landmark

    def find(self, frame: Frame, *, only: str | None = None) -> list[Sighting]:
        """The landmarks that this frame shows, the surest first. Where two lie on the same spot, the surer one.

        `only`: look for this one alone, which takes a fraction of the time.
        """
        if only is None and not self._landmarks:
            return []
        pyramid, plan = Pyramid(frame.image), self._planned(frame.camera, only)
        seen = [self._verified(pyramid, plan, *candidate) for candidate in plan.shortlist.candidates(pyramid)]
        kept: list[Sighting] = []
        spots: list[tuple[float, float, float, float]] = []
        for number, placement, confidence in sorted((s for s in seen if s is not None), key=lambda s: -s[2]):
            box = outline(placement, plan.lenses[plan.landmarks[number].box is None])
            (x, y), reach_x, reach_y = box.center_px, SAME_SPOT * box.width, SAME_SPOT * box.height
            if not any(abs(x - other_x) < rx and abs(y - other_y) < ry for other_x, other_y, rx, ry in spots):
                spots.append((x, y, reach_x, reach_y))
                kept.append(_sighting(plan, number, placement, confidence, box))
        return kept

    def _check(self, box: Box | None, frame: Frame) -> None:
        if box is None:
            return
        rows, columns = frame.image.shape
        inside = box.clipped(columns, rows)
        if inside is None:
            raise ValueError("the box is outside of the frame")
        if inside.width * inside.height < 0.8 * box.width * box.height:
            raise ValueError("a fifth or more of the box is outside of the frame")
        if min(box.width, box.height) < self._settings.smallest_side_px:
            raise ValueError(f"too small: {box.width:.0f}x{box.height:.0f} px")

    def _planned(self, camera: PinholeCamera, only: str | None) -> _Plan:
        """Made again only when a landmark changed, or the camera, or what is looked for."""
        if self._plan is None or self._plan.camera != camera or self._plan.only != only:
            landmarks = self.landmarks if only is None else [self._landmarks[only]]
            lenses = lens_of(camera, curved=False), lens_of(camera, curved=True)
            shortlist = Shortlist(landmarks, camera, self._settings.shortlist)
            self._plan = _Plan(camera, lenses, only, landmarks, shortlist, {})
        return self._plan

    def _verified(
        self, pyramid: Pyramid, plan: _Plan, number: int, start: np.ndarray
    ) -> tuple[int, np.ndarray, float] | None:
        landmark = plan.landmarks[number]
        if number not in plan.known:
            plan.known[number] = self._verifier.known(landmark)
        verified = self._verifier.verify(pyramid, plan.known[number], plan.lenses[landmark.box is None], start)
        return None if verified is None else (number, *verified)


def _sighting(plan: _Plan, number: int, placement: np.ndarray, confidence: float, box: Box) -> Sighting:
    landmark, camera = plan.landmarks[number], plan.camera
    x, y = to_pixel(placement[0], placement[1], plan.lenses[landmark.box is None])
    return Sighting(
        landmark=landmark,
        confidence=confidence,
        placement=placement,
        bearing_rad=camera.bearing_rad(x),
        elevation_rad=camera.elevation_rad(y),
        zoom=float(placement[HEIGHT] / plan.shortlist.placements[number][HEIGHT]),
        box=box,
    )
