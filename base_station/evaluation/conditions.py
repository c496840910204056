"""The ten conditions under which trackers are compared, each with seeded random parameters and exact truth.

Under every condition the target is also displaced sideways by up to 50 px. A disturbed view is made in the order of
nature: geometry, something in front of the target, motion blur, light, noise; and rounded to uint8 at last.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from base_station.evaluation.worlds import VIEW_COLUMNS, VIEW_ROWS, World
from base_station.geometry import PinholeCamera
from base_station.types import Box

SHIFT_PX = 50.0
CAMERA = PinholeCamera.with_fov(VIEW_COLUMNS, VIEW_ROWS)
TARGET = Box.around((VIEW_COLUMNS - 1) / 2, (VIEW_ROWS - 1) / 2, 240, 180)
WHOLE_VIEW = Box(0, 0, VIEW_COLUMNS, VIEW_ROWS)


@dataclass(frozen=True, kw_only=True)
class Disturbance:
    """What differs between the reference view and another one."""

    dx: float = 0.0
    """Displacement to the right, px: the truth."""
    dy: float = 0.0
    """Downwards."""
    zoom: float = 1.0
    """Enlargement about the middle of the view, before the displacement."""
    hidden_share: float = 0.0
    """Of the target's area, covered by something else."""
    blur_px: int = 0
    """Length of the streak of a pixel, along the row. Odd, so that the middle stays where it is."""
    gamma: float = 1.0
    gain: float = 1.0
    offset: float = 0.0
    """Grey levels."""
    gradient: float = 0.0
    """Grey levels added at the right end of a row, and taken away at the left."""
    noise: float = 0.0
    """Standard deviation, grey levels."""


Draw = Callable[[np.random.Generator], Disturbance]


def _sideways(rng: np.random.Generator) -> float:
    return float(rng.uniform(-SHIFT_PX, SHIFT_PX))


def _shift(rng: np.random.Generator) -> Disturbance:
    return Disturbance(dx=_sideways(rng))


def _noise(rng: np.random.Generator) -> Disturbance:
    return Disturbance(dx=_sideways(rng), noise=10)


def _gain_offset(rng: np.random.Generator) -> Disturbance:
    return Disturbance(dx=_sideways(rng), gain=rng.uniform(0.4, 1.6), offset=rng.uniform(-40, 40))


def _gamma(rng: np.random.Generator) -> Disturbance:
    return Disturbance(dx=_sideways(rng), gamma=2 ** rng.uniform(-1, 1))


def _gradient(rng: np.random.Generator) -> Disturbance:
    return Disturbance(dx=_sideways(rng), gradient=40 * (-1) ** int(rng.integers(2)))


def _zoom(rng: np.random.Generator) -> Disturbance:
    return Disturbance(dx=_sideways(rng), zoom=math.exp(rng.uniform(math.log(0.7), math.log(1.4))))


def _vertical(rng: np.random.Generator) -> Disturbance:
    return Disturbance(dx=_sideways(rng), dy=rng.uniform(-6, 6))


def _blur(rng: np.random.Generator) -> Disturbance:
    return Disturbance(dx=_sideways(rng), blur_px=9)


def _occlusion(rng: np.random.Generator) -> Disturbance:
    return Disturbance(dx=_sideways(rng), hidden_share=0.25)


def _all(rng: np.random.Generator) -> Disturbance:
    return Disturbance(
        dx=_sideways(rng), dy=rng.uniform(-4, 4), zoom=rng.uniform(0.9, 1.1), gain=0.6, offset=20, noise=8
    )


CONDITIONS: dict[str, Draw] = {
    "shift": _shift,
    "noise": _noise,
    "gain_offset": _gain_offset,
    "gamma": _gamma,
    "gradient": _gradient,
    "zoom": _zoom,
    "vertical": _vertical,
    "blur": _blur,
    "occlusion": _occlusion,
    "all": _all,
}


def disturbed_view(
    world: World,
    disturbance: Disturbance,
    rng: np.random.Generator,
    *,
    cover: np.ndarray | None = None,
    is_place: bool = False,
) -> np.ndarray:
    """uint8 (480, 640), read-only. `cover`: the view that hides a part of the target. A place is seen by a camera that
    turns, a target displaces itself."""
    d = disturbance
    view = world.turned_view(d.dx, d.dy, d.zoom, CAMERA) if is_place else world.view(d.dx, d.dy, d.zoom)
    if d.hidden_share and cover is not None:
        _hide(view, cover, d, WHOLE_VIEW if is_place else TARGET, rng)
    if d.blur_px:
        view = cv2.blur(view, (d.blur_px, 1), borderType=cv2.BORDER_REPLICATE)
    if d.gamma != 1:
        view = 255 * (np.clip(view, 0, 255) / 255) ** np.float32(d.gamma)
    view = d.gain * view + np.float32(d.offset)
    if d.gradient:
        view += np.linspace(-d.gradient, d.gradient, VIEW_COLUMNS, dtype=np.float32)
    if d.noise:
        view += d.noise * rng.standard_normal(view.shape, dtype=np.float32)
    return _as_image(view)


def reference_view(world: World, *, is_place: bool = False) -> np.ndarray:
    """The view that is learned: the world's, undisturbed."""
    return disturbed_view(world, Disturbance(), np.random.default_rng(0), is_place=is_place)


def _as_image(view: np.ndarray) -> np.ndarray:
    image = np.clip(np.round(view), 0, 255).astype(np.uint8)
    image.flags.writeable = False
    return image


def _hide(view: np.ndarray, cover: np.ndarray, d: Disturbance, box: Box, rng: np.random.Generator) -> None:
    """Put an upright piece of another view somewhere in front of the target."""
    share = math.exp(rng.uniform(math.log(d.hidden_share), 0))  # of the width; the height makes up for it
    width, height = box.width * d.zoom * share, box.height * d.zoom * d.hidden_share / share
    x, y = box.center_px
    left = x + d.dx - box.width * d.zoom / 2 + rng.random() * (box.width * d.zoom - width)
    top = y + d.dy - box.height * d.zoom / 2 + rng.random() * (box.height * d.zoom - height)
    rows = slice(max(round(top), 0), max(round(top + height), 0))
    columns = slice(max(round(left), 0), max(round(left + width), 0))
    view[rows, columns] = cover[rows, columns]


def views_without_target(reference: np.ndarray, other: np.ndarray, *, is_place: bool = False) -> dict[str, np.ndarray]:
    """Views (480, 640) that do not show what was learned in the reference, though some look much like it.

    `other`: the same middle as the reference in another world. mirrored: left is right. shuffled: the quarters of the
    target (of the view, for a place) have changed places crosswise. spectrum: the reference's amplitude at every
    frequency, the other's phases.
    """
    shuffled = reference.copy()
    box = WHOLE_VIEW if is_place else TARGET
    left, top, width, height = (round(v) for v in (box.x, box.y, box.width, box.height))
    part = shuffled[top : top + height, left : left + width]
    part[:] = np.roll(part, (height // 2, width // 2), (0, 1))
    mean = reference.mean()
    phases = np.exp(1j * np.angle(np.fft.rfft2(other - other.mean())))
    spectrum = np.fft.irfft2(np.abs(np.fft.rfft2(reference - mean)) * phases, reference.shape)
    views = {"other": other, "mirrored": reference[:, ::-1], "shuffled": shuffled, "spectrum": spectrum + mean}
    return {name: np.ascontiguousarray(_as_image(view)) for name, view in views.items()}


def looks_without_target(
    reference: np.ndarray, others: Sequence[np.ndarray], count: int, rng: np.random.Generator, *, is_place: bool = False
) -> Iterator[tuple[str, np.ndarray]]:
    """`count` times the four `views_without_target`, with one of the `others` after the other.

    From the second time on they are displaced sideways (what leaves at one side enters at the other), in other light,
    and with noise: as often as not in ways under which the target itself is tracked.
    """
    for number in range(count):
        views = views_without_target(reference, others[number % len(others)], is_place=is_place)
        for kind, view in views.items():
            if number:
                moved = np.roll(view, round(_sideways(rng)), 1)
                light = rng.uniform(0.6, 1.4) * (moved.astype(np.float32) - 128) + 128 + rng.uniform(-20, 20)
                view = _as_image(light + rng.uniform(0, 10) * rng.standard_normal(view.shape, dtype=np.float32))
            yield kind, view
