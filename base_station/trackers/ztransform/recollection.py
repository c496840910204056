"""The loose target as it was learned: is what is followed still like that, and if not, where in the frame is it?

The filters of `loose.py` go on learning, and so they may learn something else: what passed before the target, or the
background. Once that happened the target is mostly out of their window. So the filter of the first frame is kept. In
every third frame it says how sharply it answers where the target is thought to be. While that is too little on the
average, or the target is lost, it looks at one window in every other frame, the nearest first, until all of the frame
was seen; what it finds twice running is the target, and what was learned since is forgotten. See the README, section 7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from base_station.trackers.ztransform.kernels import HEIGHT, KEYSTONE, WIDTH, X, Y
from base_station.trackers.ztransform.loose import LooseFollower, Sighting
from base_station.trackers.ztransform.pyramid import Pyramid

AT_FIRST = 12.0
"""Familiarity of what was just learned; a usual one."""


@dataclass(frozen=True, kw_only=True)
class RecollectionSettings:
    """When to doubt, and when to be sure. Sharpness: see `correlation.Peak`; sides: roots of width times height."""

    asked_every: int = 3
    """Frames from one measurement of the familiarity to the next."""
    rate: float = 0.25
    """Of the running mean of familiarities, per measurement."""
    doubtful: float = 7.0
    """A familiarity below this is doubtful: of places that answered less sharply a third were right, of others nine
    tenths."""
    look_every: int = 2
    """Frames from one look elsewhere to the next while in doubt. A find is looked at again in the very next one."""
    step: float = 1.2
    """Of the windows, in sides of the target."""
    other_size: float = 0.15
    """If the logarithm of its size against the learned one is beyond this, it is looked for in both sizes."""
    sharpness: float = 8.0
    """That something elsewhere must have to be looked at again..."""
    clearer: float = 3.0
    """... and by how much more than the familiarity of what is followed..."""
    again: float = 7.0
    """... and then, to be the target..."""
    near: float = 0.3
    """... so many sides from there at most."""
    own: float = 1.0
    """Sides about where the target is followed, in which the follower knows better: of 38 clear finds
    there that differed from its own, 24 were wrong and it was right, 14 the other way round."""


class Recollection:
    """Beside a `LooseFollower`, which keeps the first filter. `start` where that one starts, `look` after its looks."""

    def __init__(self, loose: LooseFollower, settings: RecollectionSettings) -> None:
        self._loose, self._settings = loose, settings
        self.start()

    def start(self) -> None:
        """Nothing is doubtful: the target was just learned, or seen by someone who knows."""
        self._familiarity, self._frames = AT_FIRST, 0
        self._found: np.ndarray | None = None
        self._windows: list[np.ndarray] = []

    def look(self, pyramid: Pyramid, placement: np.ndarray, *, is_seen: bool) -> Sighting | None:
        """Where the target is instead, or None: no doubt, or not found.

        `placement`: where the follower saw it in this frame (`is_seen`), or else where it was last.
        """
        settings = self._settings
        self._frames += 1
        if is_seen and self._frames % settings.asked_every == 0:
            self._familiarity += settings.rate * (self._loose.familiarity() - self._familiarity)
        if is_seen and self._familiarity >= settings.doubtful:
            self._found, self._windows = None, []
            return None
        start, self._found = self._found, None
        if start is not None:
            return self._confirmed(pyramid, start, placement if is_seen else None)
        if self._frames % settings.look_every:
            return None
        if not self._windows:
            self._windows = windows(placement, self._loose.learned, pyramid.image.shape, settings)
        sighting = self._loose.recall(pyramid, self._windows.pop())
        least = self._familiarity + settings.clearer if is_seen else 0.0
        if sighting.sharpness >= max(settings.sharpness, least):
            self._found = sighting.placement
        return None

    def _confirmed(self, pyramid: Pyramid, start: np.ndarray, placement: np.ndarray | None) -> Sighting | None:
        """A find of the frame before, if it is there again and not about where the target is followed anyway."""
        settings, sighting = self._settings, self._loose.recall(pyramid, start)
        if sighting.sharpness < settings.again or _sides_off(sighting.placement, start) > settings.near:
            return None
        self._windows = []
        if placement is not None and _sides_off(sighting.placement, placement) <= settings.own:
            return None
        self._loose.restore()
        self.start()
        return sighting


def windows(
    last: np.ndarray, learned: np.ndarray, shape: tuple[int, ...], settings: RecollectionSettings
) -> list[np.ndarray]:
    """Placements whose windows together cover a frame of this shape, in one size or two; the last is the nearest."""
    sizes = [last[[WIDTH, HEIGHT]]]
    if abs(math.log(last[WIDTH] / learned[WIDTH])) > settings.other_size:
        sizes.append(learned[[WIDTH, HEIGHT]])
    found = []
    for size in sizes:
        step = settings.step * math.sqrt(size[0] * size[1])
        across, down = (max(math.ceil(length / step), 1) for length in (shape[1], shape[0]))
        for i in range(across):
            for j in range(down):
                one = last.copy()
                one[X], one[Y] = (i + 0.5) * shape[1] / across, (j + 0.5) * shape[0] / down
                one[[WIDTH, HEIGHT]], one[KEYSTONE] = size, 0.0
                found.append(one)
    return sorted(found, key=lambda one: -math.hypot(one[X] - last[X], one[Y] - last[Y]))


def _sides_off(placement: np.ndarray, other: np.ndarray) -> float:
    """How far their middles are apart, in sides of the first."""
    x, y, width, height, _ = placement.tolist()
    return math.hypot(x - other[X], y - other[Y]) / math.sqrt(width * height)
