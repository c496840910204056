"""Following what changes its shape: a walking person, a turning head, a hand.

Where it is says a correlation filter on the phase channels of a window about it; how large it is, and how far it has
turned in the picture, says another one on a log-polar patch, in which growing is a shift along the rows and turning one
along the columns. The window turns with the target. Both filters go on learning, a little in every frame, as long as
the target is seen about as well as usual. See the README, section 7.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import cv2
import numpy as np
from numba import njit

from base_station.trackers.ztransform.channels import ChannelReader, ChannelSettings, learn_light
from base_station.trackers.ztransform.correlation import CorrelationFilter, FilterSettings, Peak
from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH, X, Y
from base_station.trackers.ztransform.pyramid import Pyramid


@dataclass(frozen=True, kw_only=True)
class LooseSettings:
    """Of both filters. Sizes are against the target's: the root of its width times its height."""

    window: float = 3.25
    """Side of the window that is searched."""
    cells: int = 48
    """Across the window."""
    flat: float = 0.8
    """Of the target's width and height that is learned in full."""
    mask: float = 1.25
    """Of its width and height beyond which nothing is learned."""
    by_likelihood: float = 0.5
    """How far a cell's light decides whether it is learned: 0 not at all, 1 alone."""
    likelihood_weight: float = 2.0
    """Of the channel of likelihoods against those of phase."""
    grey_levels: int = 32
    """Bins of the histograms."""
    histogram_rate: float = 0.08
    """How much of a frame's histograms is taken over."""
    position: FilterSettings = field(
        default_factory=lambda: FilterSettings(label_cells=0.8, regularisation=1e-3, rate=0.03)
    )
    """Where it is."""
    views: tuple[tuple[float, float], ...] = ((20.0, 0.0), (-20.0, 0.0), (0.0, 0.1), (0.0, -0.1))
    """As what it is learned besides as it is: turned by so many degrees, and larger by this logarithm. What all of them
    share is what stays when it turns or bends."""
    channels: ChannelSettings = field(default_factory=ChannelSettings)
    """Read about it."""
    polar_cells: int = 32
    """Rings, and rays, of the log-polar patch."""
    polar_outer: float = 0.8
    """Radius of its outermost ring, in widths and heights of the target."""
    polar_inner: float = 0.15
    """Radius of the innermost ring, against the outermost."""
    polar_rise: float = 0.7
    """Where between the innermost and the outermost ring the window is highest: near the outline."""
    zoom: FilterSettings = field(
        default_factory=lambda: FilterSettings(label_cells=1.0, regularisation=1e-2, rate=0.06)
    )
    """How large it is."""
    polar_channels: ChannelSettings = field(
        default_factory=lambda: ChannelSettings(rates=(0.4, 1.0), slope=1.5, floor=0.5)
    )
    """Read from the log-polar patch."""
    zoom_least: float = 0.1
    """An answer below this says nothing about the size..."""
    turn_least: float = 0.2
    """... and below this nothing about how far it has turned: people turn to nowhere while they walk."""
    turn_damping: float = 0.5
    """Of a measured turn that is taken."""
    turn_step_rad: float = 0.5
    """A larger turn at once is none."""
    zoom_damping: float = 0.45
    """Of a measured change of size that is taken."""
    zoom_step: float = 0.1
    """Largest change of the logarithm of the size at once."""
    zoom_range: float = 5.0
    """Against the learned size, either way."""
    agreed_sharpness: float = 6.0
    """For `resembles`. Of 552 looks at targets in other light, other size or turned by up to 45 degrees 86 % pass, of
    345 at other places 0.3 %, of 69 mirrored pictures 13 %."""
    agreed_offset: float = 0.08
    """For `resembles`: how far off the peak may be, in sides of the target."""
    least_sharpness: float = 6.3
    """An answer that stands out less is not the target's."""


@dataclass(frozen=True)
class Sighting:
    """What one look gave. `sharpness`: see `correlation.Peak`."""

    placement: np.ndarray
    sharpness: float


@njit(cache=True, fastmath=True, error_model="numpy")
def sample_polar(image, scale, placement, turn_rad, across, down, patch):
    """Bilinear reads at placement + (across width, down height) turned about it, float32 tables as large as the patch;
    the frame's border repeats. `image`: the frame at 1 / scale of its size."""
    height, width = image.shape
    offset = 0.5 * (scale - 1)
    cosine, sine = math.cos(turn_rad) / scale, math.sin(turn_rad) / scale
    right_x, down_x = np.float32(placement[WIDTH] * cosine), np.float32(-placement[HEIGHT] * sine)
    right_y, down_y = np.float32(placement[WIDTH] * sine), np.float32(placement[HEIGHT] * cosine)
    start_x, start_y = np.float32((placement[X] - offset) / scale), np.float32((placement[Y] - offset) / scale)
    low, right, bottom = np.float32(0.0), np.float32(width - 1.001), np.float32(height - 1.001)
    for i in range(patch.shape[0]):
        for j in range(patch.shape[1]):
            x = min(max(start_x + across[i, j] * right_x + down[i, j] * down_x, low), right)
            y = min(max(start_y + across[i, j] * right_y + down[i, j] * down_y, low), bottom)
            column, row = int(x), int(y)
            part_x, part_y = x - np.float32(column), y - np.float32(row)
            above, above_right = np.float32(image[row, column]), np.float32(image[row, column + 1])
            below, below_right = np.float32(image[row + 1, column]), np.float32(image[row + 1, column + 1])
            above += (above_right - above) * part_x
            below += (below_right - below) * part_x
            patch[i, j] = above + (below - above) * part_y


@njit(cache=True, fastmath=True, error_model="numpy")
def weigh_mask(mask, light, down, right, share, likelihood_weight, out):
    """The mask, less where the light (channel with the likelihood as its imaginary part, moved) is the background's."""
    rows, columns = mask.shape
    half, one, zero = np.float32(0.5), np.float32(1.0), np.float32(0.0)
    for y in range(rows):
        for x in range(columns):
            source_y, source_x = y + down, x + right
            inside = source_y >= 0 and source_y < rows and source_x >= 0 and source_x < columns
            likely = light[source_y, source_x, 1] / likelihood_weight if inside else -one
            out[y, x] = mask[y, x] * (one - share + share * min(max(half + likely, zero), one))


class LooseFollower:
    """One loose target. `start`, then `look` at every frame, and `adapt` where the look is believed."""

    def __init__(self, settings: LooseSettings) -> None:
        self._settings = s = settings
        self._channels, self._polar_channels = ChannelReader(s.channels), ChannelReader(s.polar_channels)
        fade = np.hanning(s.cells + 2)[1:-1]
        self._position = CorrelationFilter(np.outer(fade, fade), s.position)
        self._zoom = CorrelationFilter(_polar_window(s), s.zoom)
        rings = np.exp(math.log(s.polar_inner) * (1 - (np.arange(s.polar_cells) + 0.5) / s.polar_cells))
        rays = 2 * np.pi * np.arange(s.polar_cells) / s.polar_cells
        self._across = (s.polar_outer * rings[:, None] * np.cos(rays)).astype(np.float32)
        self._down = (s.polar_outer * rings[:, None] * np.sin(rays)).astype(np.float32)
        self._polar = np.empty((s.polar_cells, s.polar_cells), np.float32)
        self._log_ring = -math.log(s.polar_inner) / s.polar_cells
        self._patch = np.empty((s.cells, s.cells), np.uint8)
        self._inside, self._outside = np.zeros(s.grey_levels, np.float32), np.zeros(s.grey_levels, np.float32)
        self._likelihood = np.zeros(s.grey_levels, np.float32)

    def start(self, pyramid: Pyramid, placement: np.ndarray) -> None:
        """Remember what is at this placement (see `kernels`; the keystone does not count)."""
        self._learned, self._size_next = placement.copy(), True
        self.turn_rad = 0.0
        """How far it has turned in the picture, clockwise, since."""
        self._mask, self._inner_box, self._outer_box = self._target_mask(placement), self._box(0.8), self._box(1.2)
        self._sample(pyramid, placement)
        self._count(1.0, 0, 0)
        read = self._read()
        self._position.learn(read, self._weighed(read, 0, 0))
        self._zoom.learn(self._read_polar(pyramid, placement))
        for number, (turn_deg, log_size) in enumerate(self._settings.views, 2):
            view = placement.copy()
            view[[WIDTH, HEIGHT]] *= math.exp(log_size)
            self._sample(pyramid, view, math.radians(turn_deg))
            read = self._read()
            self._position.learn_also(read, self._weighed(read, 0, 0), number)
        self._position.keep()
        self._zoom.keep()
        self._kept_light = self._inside.copy(), self._outside.copy(), self._likelihood.copy()

    @property
    def learned(self) -> np.ndarray:
        """The placement that it started at."""
        return self._learned

    def restore(self) -> None:
        """Forget all that was learned since `start`."""
        self._position.restore()
        self._zoom.restore()
        self._inside, self._outside, self._likelihood = (part.copy() for part in self._kept_light)
        self.turn_rad = 0.0

    def familiarity(self) -> float:
        """How sharply the target as it was at `start` is seen where the last look saw it."""
        return self._position.familiarity(self._peak)

    def recall(self, pyramid: Pyramid, start: np.ndarray) -> Sighting:
        """As `look`, for the target as it was at `start`, upright. `adapt` needs another `look` first."""
        self._sample(pyramid, start)
        read = self._channels.read(self._patch, self._kept_light[-1], self._settings.likelihood_weight)
        peak = self._position.recall(read)
        return Sighting(self._placed(pyramid, start, peak, 0.0), peak.sharpness)

    def upright(self) -> None:
        """The target stands as it was learned, says someone else."""
        self.turn_rad = 0.0

    def look(self, pyramid: Pyramid, start: np.ndarray) -> Sighting:
        """Where it is, looked for around `start`, with the size at `start`."""
        self._sample(pyramid, start, self.turn_rad)
        self._read_last = self._read()
        peak = self._position.find(self._read_last)
        if peak.sharpness < self._settings.least_sharpness:
            in_any_light = self._position.find_without(self._read_last)
            peak = max(peak, in_any_light, key=lambda one: one.sharpness)
        self._peak = peak
        self._found = self._placed(pyramid, start, peak, self.turn_rad)
        return Sighting(self._found, peak.sharpness)

    def resembles(self, pyramid: Pyramid, placement: np.ndarray) -> bool:
        """Whether the target is just here and upright, as someone else says, in whatever light."""
        self._sample(pyramid, placement)
        peak, s = self._position.find(self._read_shape()), self._settings
        off = math.hypot(peak.rows, peak.columns) * s.window / s.cells
        return peak.sharpness >= s.agreed_sharpness and off <= s.agreed_offset

    def adapt(self, pyramid: Pyramid, times: int = 1) -> np.ndarray:
        """Believe the last look: learn from it, and give the placement with the size.

        In turns, to halve the cost: what it looks like in one frame, how large and how far turned it is in the next.
        `times`: learn as much as from so many frames like this one.
        """
        peak = self._peak
        if self._size_next:
            self._measure_size(pyramid, self._found, times)
        else:
            down, right = round(peak.rows), round(peak.columns)
            self._position.adapt(self._read_last, peak, self._weighed(self._read_last, down, right), times)
            self._count(1 - (1 - self._settings.histogram_rate) ** times, down, right)
        self._size_next = not self._size_next
        return self._found

    def _measure_size(self, pyramid: Pyramid, placement: np.ndarray, times: int) -> None:
        """Change the placement's size to that of the target, turn with it, and learn how it looks so."""
        s, polar = self._settings, self._read_polar(pyramid, placement)
        growth = self._zoom.find(polar)
        turn_rad = growth.columns * 2 * math.pi / s.polar_cells
        if growth.height > s.turn_least:
            self.turn_rad += s.turn_damping * turn_rad if abs(turn_rad) < s.turn_step_rad else 0.0
        else:  # learned as if the target had not turned
            growth = dataclasses.replace(growth, columns=0.0)
        self._zoom.adapt(polar, growth, times=times)
        if growth.height > s.zoom_least:
            step = s.zoom_damping * growth.rows * self._log_ring
            wanted = math.log(placement[WIDTH] / self._learned[WIDTH]) + min(max(step, -s.zoom_step), s.zoom_step)
            zoom = math.exp(min(max(wanted, -math.log(s.zoom_range)), math.log(s.zoom_range)))
            placement[[WIDTH, HEIGHT]] = zoom * self._learned[[WIDTH, HEIGHT]]

    def _placed(self, pyramid: Pyramid, start: np.ndarray, peak: Peak, turn_rad: float) -> np.ndarray:
        """Where the peak of a window about `start` lies in the frame."""
        placement, cell = start.copy(), self._side(start) / self._settings.cells
        cosine, sine = math.cos(turn_rad) * cell, math.sin(turn_rad) * cell
        x = placement[X] + cosine * peak.columns - sine * peak.rows
        y = placement[Y] + sine * peak.columns + cosine * peak.rows
        placement[X] = min(max(x, 0.0), pyramid.image.shape[1] - 1.0)
        placement[Y] = min(max(y, 0.0), pyramid.image.shape[0] - 1.0)
        return placement

    def _side(self, placement: np.ndarray) -> float:
        _, _, width, height, _ = placement.tolist()
        return self._settings.window * math.sqrt(width * height)

    def _sample(self, pyramid: Pyramid, placement: np.ndarray, turn_rad: float = 0.0) -> None:
        """The window about a placement, turned, a bilinear read per cell; the frame's border repeats."""
        cell = self._side(placement) / self._settings.cells
        image, scale, _ = pyramid.for_cell(cell)
        middle = (self._settings.cells - 1) / 2
        x, y = ((centre - (scale - 1) / 2) / scale for centre in placement[:2].tolist())
        cosine, sine = math.cos(turn_rad) * cell / scale, math.sin(turn_rad) * cell / scale
        window = np.array([[cosine, -sine, x - middle * (cosine - sine)], [sine, cosine, y - middle * (sine + cosine)]])
        cv2.warpAffine(
            image, window, self._patch.shape[::-1], self._patch, cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            cv2.BORDER_REPLICATE,
        )  # fmt: skip

    def _read(self) -> np.ndarray:
        return self._channels.read(self._patch, self._likelihood, self._settings.likelihood_weight)

    def _read_shape(self) -> np.ndarray:
        """As `_read`, without what the light says: after a sudden change of it every grey level is a stranger."""
        return self._channels.read(self._patch, self._likelihood, 0.0)

    def _read_polar(self, pyramid: Pyramid, placement: np.ndarray) -> np.ndarray:
        ring = self._log_ring * self._settings.polar_outer * math.sqrt(placement[WIDTH] * placement[HEIGHT])
        image, scale, _ = pyramid.for_cell(ring)
        sample_polar(image, scale, placement, self.turn_rad, self._across, self._down, self._polar)
        return self._polar_channels.read(self._polar, np.zeros(2, np.float32), 0.0)

    def _weighed(self, read: np.ndarray, down: int, right: int) -> np.ndarray:
        s, out = self._settings, np.empty_like(self._mask)
        weigh_mask(self._mask, read[-1], down, right, np.float32(s.by_likelihood), np.float32(s.likelihood_weight), out)
        return out

    def _count(self, rate: float, down: int, right: int) -> None:
        """Take the histograms of target and background in the patch sampled last; the target is (down, right) off."""
        off = np.array((down, down, right, right))
        learn_light(
            self._patch, self._inner_box + off, self._outer_box + off, np.float32(rate), self._inside, self._outside,
            self._likelihood,
        )  # fmt: skip

    def _box(self, part: float) -> np.ndarray:
        """First row, past-last row, first column, past-last column of this part of the target, mid-window."""
        half, cell = self._settings.cells / 2, self._side(self._learned) / self._settings.cells
        reach_y, reach_x = (part / 2 * self._learned[side] / cell for side in (HEIGHT, WIDTH))
        return np.array([round(half - reach_y), round(half + reach_y), round(half - reach_x), round(half + reach_x)])

    def _target_mask(self, placement: np.ndarray) -> np.ndarray:
        s, side = self._settings, self._side(placement)
        away = np.abs((np.arange(s.cells) - (s.cells - 1) / 2) / s.cells * side)
        fades = []
        for size in (placement[HEIGHT], placement[WIDTH]):
            t = np.clip((2 * away / size - s.flat) / (s.mask - s.flat), 0, 1)
            fades.append(np.cos(np.pi / 2 * t) ** 2)
        return np.outer(*fades).astype(np.float32)


def _polar_window(s: LooseSettings) -> np.ndarray:
    """Rises along the rings to near the outline and falls beyond it; the rays go all around and need no window."""
    t = (np.arange(s.polar_cells) + 0.5) / s.polar_cells
    rise, fall = (
        np.sin(np.pi / 2 * t / s.polar_rise) ** 2,
        np.cos(np.pi / 2 * (t - s.polar_rise) / (1 - s.polar_rise)) ** 2,
    )
    return np.repeat(np.where(t < s.polar_rise, rise, fall)[:, None], s.polar_cells, 1)
