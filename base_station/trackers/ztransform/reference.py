"""What the compiled kernels mean, in plain numpy: the definitions, summed out, without recursion.

Slow on purpose. The tests hold `kernels.py`, `search_kernels.py` and `thesis/kernels.py` against these; the README
derives them.
"""

from __future__ import annotations

import numpy as np


def one_sided_transform(row: np.ndarray, anchor: int, z: complex, *, order: int = 1) -> complex:
    """sum_{u >= 0} row[anchor + u] z^-u; with order 2, sum u row[anchor + u] z^-u, which is -z times its derivative.

    Source: Khalil 2021, section 3.3.2.
    """
    tail = np.asarray(row, float)[anchor:]
    u = np.arange(len(tail))
    return complex(np.sum((u if order == 2 else 1) * tail * np.asarray(z, complex) ** -u))


def shifted_transform(transform: complex, head: np.ndarray, z: complex) -> complex:
    """Transform of the row from len(head) pixels further on, by the shift property, eq. (3.4) of Khalil 2021.

    `head`: the pixels that were stepped over. z^n0 (X(z) - sum_{k < n0} x[k] z^-k).
    """
    n0 = len(head)
    return complex(z**n0 * (transform - np.sum(head * np.asarray(z, complex) ** -np.arange(n0))))


def predicted_transforms(row: np.ndarray, anchor: int, z: complex, span: int) -> np.ndarray:
    """The transforms about the anchor, to the right and left, were the row moved by -span..span; (2 span + 1, 2).

    Algorithm 4.1 of Khalil 2021 foretells them by eqs. (3.3) and (3.4); here the row is really moved, and summed anew.
    """
    row = np.asarray(row, float)
    middles = [anchor - shift for shift in range(-span, span + 1)]
    right = [one_sided_transform(row, m, z) for m in middles]
    left = [one_sided_transform(row[::-1], len(row) - 1 - m, z) for m in middles]
    return np.stack([right, left], 1)


def fit_shift(predicted: np.ndarray, seen: np.ndarray, any_gain: bool) -> tuple[float, float, float]:
    """Index with fraction, residual 0..1 and gain of the prediction that is seen, by trying 1001 fractions of each."""
    best = (0.0, np.inf, 0.0)
    whole = float((np.abs(seen) ** 2).sum())
    for i in range(len(predicted) - 1):
        for part in np.linspace(0, 1, 1001):
            between = (1 - part) * predicted[i] + part * predicted[i + 1]
            length = float((np.abs(between) ** 2).sum())
            gain = max(float((between.conj() * seen).real.sum()) / length, 0.0) if any_gain else 1.0
            residual = float(np.sqrt((np.abs(seen - gain * between) ** 2).sum() / whole))
            if residual < best[1]:
                best = (i + part, residual, gain)
    return best


def region_transforms(row: np.ndarray, regions: int, z: np.ndarray) -> np.ndarray:
    """Algorithm 4.2 of Khalil 2021: X(z) of each region by itself, from its left and from its right; (regions, zs, 2).

    Divided by the sum of the weights, so that the numbers are grey levels whatever z and the region's length.
    """
    out = np.empty((regions, len(z), 2))
    for r in range(regions):
        part = np.asarray(row, float)[r * len(row) // regions : (r + 1) * len(row) // regions]
        for k, pole in enumerate(z):
            weights = pole ** -np.arange(len(part), dtype=float)
            out[r, k] = (part * weights).sum() / weights.sum(), (part[::-1] * weights).sum() / weights.sum()
    return out


def recursive_transform(row: np.ndarray, z: complex) -> np.ndarray:
    """The first-order transform about every pixel at once: R(m) = x[m] + R(m + 1) / z. Complex, as long as the row."""
    out = np.zeros(len(row) + 1, complex)
    for m in range(len(row) - 1, -1, -1):
        out[m] = row[m] + out[m + 1] / z
    return out[:-1]


def sample_patch(
    image: np.ndarray, scale: int, placement: np.ndarray, lens: np.ndarray, samples: int, cells: int
) -> tuple[np.ndarray, np.ndarray]:
    """Patch (cells, cells) and which of its cells are in the frame (bool). See `kernels` for placement and lens."""
    height, width = image.shape
    middle_x, middle_y, box_width, box_height, keystone = placement
    u = (np.arange(cells * samples) + 0.5) / (cells * samples) - 0.5
    shrink = 1 / (1 + keystone * u)
    x = np.broadcast_to(middle_x + box_width * u * shrink, (len(u), len(u)))
    y = lens[3] + (middle_y - lens[3] + box_height * u[:, None]) * shrink[None]
    if lens[0] > 0:
        azimuth = (x - lens[2]) / lens[1]
        x, y = lens[2] + lens[1] * np.tan(azimuth), lens[3] + (y - lens[3]) / np.cos(azimuth)
    x, y = (x - (scale - 1) / 2) / scale, (y - (scale - 1) / 2) / scale
    cx, cy = np.clip(x, 0, width - 1.001), np.clip(y, 0, height - 1.001)
    ix, iy = cx.astype(int), cy.astype(int)
    fx, fy = cx - ix, cy - iy
    pixels = image.astype(float)
    above = pixels[iy, ix] * (1 - fx) + pixels[iy, ix + 1] * fx
    below = pixels[iy + 1, ix] * (1 - fx) + pixels[iy + 1, ix + 1] * fx
    fine = above * (1 - fy) + below * fy
    patch = fine.reshape(cells, samples, cells, samples).mean((1, 3))
    middle = samples // 2 + samples * np.arange(cells)
    v = (np.arange(cells) + 0.5) / cells - 0.5
    row = lens[3] + (middle_y - lens[3] + box_height * v[:, None]) * shrink[None, middle]
    if lens[0] > 0:
        row = lens[3] + (row - lens[3]) / np.cos(
            (middle_x + box_width * u[middle] * shrink[middle] - lens[2]) / lens[1]
        )
    column, row = x[0, middle], (row - (scale - 1) / 2) / scale
    seen = (column >= -0.5) & (column <= width - 0.5) & (row >= -0.5) & (row <= height - 0.5)
    return patch, seen


def sample_boxes(
    image: np.ndarray, scale: int, placement: np.ndarray, lens: np.ndarray, cells: int
) -> tuple[np.ndarray, np.ndarray]:
    """As `sample_patch`, but every cell is the mean of the box of pixels that it covers, as tall as in its middle."""
    edges, (x, middle, shrink) = np.arange(cells + 1) / cells - 0.5, _columns(cells, scale, placement, lens)
    y = (lens[3] + (placement[1] - lens[3] + placement[3] * edges[:, None]) * shrink + 0.5) / scale
    patch = np.stack([_box_means(image, x[i : i + 2], y[:, i])[:, 0] for i in range(cells)], 1)
    rows = (y[1:] + y[:-1]) / 2
    return patch, (middle >= 0) & (middle <= image.shape[1]) & (rows >= 0) & (rows <= image.shape[0])


def box_profiles(
    image: np.ndarray, scale: int, placement: np.ndarray, lens: np.ndarray, cells: int, bands: int, strips: int
) -> np.ndarray:
    """Row bands and column bands, (2 * bands, cells), of a placement inside of the frame: the means of their boxes.

    `strips`: boxes side by side in each cell of a column band.
    """
    rows = np.append(np.arange(bands) * (cells // bands) / cells, 1) - 0.5
    x, _, shrink = _columns(cells, scale, placement, lens)
    y = (lens[3] + (placement[1] - lens[3] + placement[3] * rows[:, None]) * shrink + 0.5) / scale
    across = np.concatenate([_box_means(image, x[i : i + 2], y[:, i]) for i in range(cells)], 1)
    x, _, shrink = _columns(bands * strips, scale, placement, lens)
    edges = np.arange(cells + 1) / cells - 0.5
    y = (lens[3] + (placement[1] - lens[3] + placement[3] * edges[:, None]) * shrink + 0.5) / scale
    down = np.concatenate([_box_means(image, x[i : i + 2], y[:, i]) for i in range(bands * strips)], 1)
    return np.concatenate([across, down.reshape(cells, bands, strips).mean(2).T])


def cell_means(image: np.ndarray, horizon_px: float, placement: np.ndarray, cells: int) -> np.ndarray:
    """Means (cells, cells) of a placement that lies in the image, its lens flat; every column of pixels is cut between
    the straight edges of the cells, at its middle."""
    x, y, width, height, keystone = placement.tolist()
    u = np.arange(cells + 1) / cells - 0.5
    edges, middles = x + width * u / (1 + keystone * u) + 0.5, np.arange(image.shape[1]) + 0.5
    across = np.minimum(edges[1:, None], middles + 0.5) - np.maximum(edges[:-1, None], middles - 0.5)
    rows = np.arange(image.shape[0])[:, None]
    lines = horizon_px + 0.5 + (y - horizon_px + height * u)[:, None] * (1 - keystone * (middles - 0.5 - x) / width)
    out = np.empty((cells, cells))
    for j in range(cells):
        down = np.clip(np.minimum(lines[j + 1], rows + 1) - np.maximum(lines[j], rows), 0, 1)
        weights = np.clip(across, 0, 1)
        out[j] = weights @ (down * image).sum(0) / (weights @ down.sum(0))
    return out


def _columns(count: int, scale: int, placement: np.ndarray, lens: np.ndarray) -> tuple[np.ndarray, ...]:
    """So many columns of a placement: their edges, their middles, and the shrinking of heights in their middles."""
    out = []
    for u in (np.arange(count + 1) / count - 0.5, (np.arange(count) + 0.5) / count - 0.5):
        shrink = 1 / (1 + placement[4] * u)
        x = placement[0] + placement[2] * u * shrink
        if lens[0] > 0:
            azimuth = (x - lens[2]) / lens[1]
            x, shrink = lens[2] + lens[1] * np.tan(azimuth), shrink / np.cos(azimuth)
        out.append((x + 0.5) / scale)
    return out[0], out[1], shrink


def _box_means(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Means between edges that may lie within pixels; pixel n lies between n and n + 1. Less than 0.02 px is none."""
    weights = []
    for edges, size in ((y, image.shape[0]), (x, image.shape[1])):
        first = np.clip(edges[:-1], 0, size - 0.04)[:, None]
        last = np.clip(edges[1:, None], first + 0.02, size - 0.02)
        pixels = np.arange(size)
        covered = np.clip(np.minimum(pixels + 1, last) - np.maximum(pixels, first), 0, 1)
        weights.append(covered / covered.sum(1, keepdims=True))
    return weights[0] @ image.astype(float) @ weights[1].T


def read_signature(
    patch: np.ndarray, bands: int, poles: np.ndarray, weights: np.ndarray, anchors: np.ndarray, taper: np.ndarray
) -> np.ndarray:
    """Normalised signature of a patch, complex, shape (2 * bands, poles, 2 sides, anchors)."""
    cells = len(patch)
    depth = cells // bands
    cuts = [slice(b * depth, (b + 1) * depth if b < bands - 1 else cells) for b in range(bands)]
    profiles = np.stack([patch[c].mean(0) for c in cuts] + [patch[:, c].mean(1) for c in cuts])
    d = np.zeros_like(profiles)
    d[:, 1:-1] = (profiles[:, 2:] - profiles[:, :-2]) / 2
    d *= taper
    distance = np.arange(cells)[None] - np.asarray(anchors)[:, None]  # (anchors, cells), to the right positive
    out = np.zeros((2 * bands, len(poles), 2, len(anchors)), complex)
    for k, (p, weight) in enumerate(zip(poles, weights, strict=True)):
        for side, u in enumerate((distance, -distance)):
            window = np.where(u > 0, u * p ** np.maximum(u, 0), 0)
            out[:, k, side] = weight * (d @ window.T)
    return out / np.sqrt((np.abs(out) ** 2).sum())


def read_field(profile: np.ndarray, poles: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Second-order transform of a profile's difference about every cell, complex, shape (cells, poles, 2 sides)."""
    cells = len(profile)
    padded = np.concatenate([profile[:1], profile, profile[-1:]]).astype(float)
    d = (padded[2:] - padded[:-2]) / 2
    distance = np.arange(cells)[None] - np.arange(cells)[:, None]
    out = np.empty((cells, len(poles), 2), complex)
    for k, (p, weight) in enumerate(zip(poles, weights, strict=True)):
        for side, u in enumerate((distance, -distance)):
            out[:, k, side] = weight * (np.where(u > 0, u * p ** np.maximum(u, 0), 0) @ d)
    return out


def score_positions(fields: np.ndarray, learned: np.ndarray, anchors: np.ndarray, least_share: float) -> np.ndarray:
    """Normalised correlation with the target's middle at each cell; -1 where too little of it is in the frame."""
    cells = fields.shape[1]
    scores = np.full(cells, -1.0)
    for m in range(cells):
        inside = (m + anchors >= 0) & (m + anchors < cells)
        here, there = fields[:, (m + anchors)[inside]].transpose(1, 0, 2), learned[inside]
        if (there**2).sum() >= least_share * (learned**2).sum():
            scores[m] = (here * there).sum() / np.sqrt((here**2).sum() * (there**2).sum() + 1e-9)
    return scores


def phase_channels(patch: np.ndarray, poles: np.ndarray, across: np.ndarray, floor: float) -> np.ndarray:
    """Phase channels of a square patch, complex, shape (2 scales, cells, cells): down the rows, then along them.

    Of the central difference (twice it), smoothed across by a real pole both ways, sum u p^u d[m + u] plus the
    conjugate of sum u p^u d[m - u]; divided by its own size plus `floor` times the root mean square of the sizes.
    """
    cells = len(patch)
    distance = np.arange(cells)[None] - np.arange(cells)[:, None]
    out = []
    for turned in (False, True):
        padded = np.pad((patch.T if turned else patch).astype(float), ((1, 1), (0, 0)), "edge")
        difference = padded[2:] - padded[:-2]
        for p, q in zip(poles, across, strict=True):
            smooth = _smoothed(_smoothed(difference.T, q)[::-1], q)[::-1].T
            window = np.where(distance > 0, distance * p ** np.maximum(distance, 0), 0)
            value = window @ smooth + np.conj(window.T @ smooth)
            value /= np.abs(value) + floor * np.sqrt((np.abs(value) ** 2).mean()) + 1e-6
            out.append(value.T if turned else value)
    return np.stack(out)


def _smoothed(rows: np.ndarray, pole: float) -> np.ndarray:
    """y[n] = (1 - pole) x[n] + pole y[n - 1], beginning with x[0]."""
    out = rows.astype(float)
    for n in range(1, len(rows)):
        out[n] = (1 - pole) * rows[n] + pole * out[n - 1]
    return out


def blocks_of(patch: np.ndarray, blocks: int) -> np.ndarray:
    """A patch (cells, cells) as (blocks * blocks, cells of a block), row by row."""
    side = len(patch) // blocks
    return patch.reshape(blocks, side, blocks, side).swapaxes(1, 2).reshape(blocks * blocks, side * side)


def robust_step(
    cut: np.ndarray, shown: np.ndarray, learned: np.ndarray, changes: np.ndarray, prior: np.ndarray
) -> np.ndarray:
    """What takes a patch, cut into blocks, back to the learned one, (parts,): the step first, then appearance.

    `learned` (blocks, n): deviations from each block's mean; `changes` (blocks, parts, n): what each part adds to them
    that no gain of light could; `shown` (blocks,) bool: wholly in the frame; `prior` (parts,): 1 / variance of each.
    """
    deviations = cut - cut.mean(1, keepdims=True)
    energies = (learned**2).sum(1)
    products = (deviations * learned).sum(1)
    gains = products / (energies + 1e-3)
    misfits = np.maximum((deviations**2).sum(1) - gains * products, 0) / (cut.shape[1] - 2)
    usual = np.median(misfits[shown]) + 0.02
    firm = shown & (energies > np.median(energies))
    whole_gain = max(np.median(gains[firm]), 0.05) if firm.any() else 0.05
    trust = 0.2 * np.median(energies) + 1e-3
    gains = np.clip((products + trust * whole_gain) / (energies + trust), 0, 3 * whole_gain)
    weights = shown * usual / (misfits + usual)
    rows = (changes * gains[:, None, None]).swapaxes(1, 2)  # as light shows it
    hessian = np.einsum("b,bni,bnj->ij", weights, rows, rows) + np.diag(prior * usual)
    return -np.linalg.solve(hessian, np.einsum("b,bni,bn->i", weights, rows, deviations))


def follow_on(step: np.ndarray, before: np.ndarray, size: np.ndarray) -> np.ndarray:
    """A step (parts,) whose first two, of a target of this size (2,), tell all that would follow in a series."""
    now, then = step[:2] * size, before[:2] * size
    share = np.clip(now @ then / (then @ then + 1e-12), 0, 0.5)
    return np.concatenate([step[:2] / (1 - share), step[2:]])


def slope_directions(patch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central differences along the rows and down (2, cells, cells), over their size and a floor; 0 at the border.

    And (cells, cells) what each was multiplied by.
    """
    inner, scales = np.zeros((2, *patch.shape)), np.zeros(patch.shape)
    inner[0, 1:-1, 1:-1] = (patch[1:-1, 2:] - patch[1:-1, :-2]) / 2
    inner[1, 1:-1, 1:-1] = (patch[2:, 1:-1] - patch[:-2, 1:-1]) / 2
    size = np.sqrt((inner**2).sum(0))[1:-1, 1:-1]
    scales[1:-1, 1:-1] = 1 / (size + 0.5 * size.mean() + 0.1)
    return inner * scales, scales


def best_part(likeness: np.ndarray, weights: np.ndarray, part: float) -> float:
    """Weighted mean over the most alike, which have this part of the whole weight; one of them may count in part."""
    order = np.argsort(-likeness)
    wanted = part * weights.sum()
    taken = np.diff(np.minimum(np.cumsum(weights[order]), wanted), prepend=0)
    return float((taken * likeness[order]).sum() / wanted)


def resemblance(patch: np.ndarray, learned: np.ndarray, blocks: int, part: float, noise: float) -> float:
    """How much a patch is like the learned one, 0..1; see `alignment_kernels`. All of it lies in the frame."""
    one, other = (cut - cut.mean(1, keepdims=True) for cut in (blocks_of(p, blocks) for p in (patch, learned)))
    faint = 0.5 * one.shape[1]
    energies = (other**2).sum(1)
    square = (one**2).sum(1)
    square = np.maximum(square - noise**2 * one.shape[1], 0.6 * square)
    light = np.minimum((one * other).sum(1) / np.sqrt((square + faint) * (energies + faint)), 1)
    (slopes, scales), (then, _) = slope_directions(patch), slope_directions(learned)
    now, then = (np.stack([blocks_of(d, blocks) for d in directions]) for directions in (slopes, then))
    then_energies, energy = (then**2).sum((0, 2)), (now**2).sum((0, 2))
    energy = np.maximum(energy - noise**2 * (blocks_of(scales, blocks) ** 2).sum(1), 0.6 * energy)
    fine = np.minimum((now * then).sum((0, 2)) / np.sqrt(energy * then_energies + 1e-6), 1)
    whole = best_part(fine, np.sqrt(then_energies), 1.0)
    parts = best_part(light, np.sqrt(energies), part), best_part(fine, np.sqrt(then_energies), part)
    return max(parts[0], 0) * max(parts[1], 0) * (0.5 + 0.5 * max(whole, 0))


def pixel_noise(image: np.ndarray, placement: np.ndarray) -> float:
    """Standard deviation of the pixels' noise in every eighth row of the target, by second differences; 0 if few."""
    x, y, width, height, _ = placement.tolist()
    rows = slice(max(int(y - height / 2), 0), max(int(y + height / 2), 0), 8)
    lines = image[rows, max(int(x - width / 2), 0) : max(int(x + width / 2), 0)].astype(int)
    fine = np.abs(lines[:, 2:] - 2 * lines[:, 1:-1] + lines[:, :-2])
    return 1.4826 * float(np.median(fine)) / np.sqrt(6) if fine.size else 0.0


def count_votes(window: np.ndarray, learned: np.ndarray, side: int, faint: float) -> np.ndarray:
    """Votes of the learned picture's square pieces for every shift of it in the window; see `pieces`."""
    shifts, n = len(window) - len(learned) + 1, len(learned) // side
    votes = np.zeros((shifts, shifts))
    for top, left, down, right in np.ndindex(n, n, shifts, shifts):
        piece = learned[top * side : (top + 1) * side, left * side : (left + 1) * side]
        seen = window[top * side + down : (top + 1) * side + down, left * side + right : (left + 1) * side + right]
        product = ((piece - piece.mean()) * (seen - seen.mean())).mean()
        weight = piece.var() / (piece.var() + 4 * faint)
        votes[down, right] += weight * max(product, 0) ** 2 / (piece.var() * (seen.var() + faint) + 1e-6)
    return votes


def turned_reads(
    image: np.ndarray, scale: int, placement: np.ndarray, turn_rad: float, across: np.ndarray, down: np.ndarray
) -> np.ndarray:
    """Bilinear reads at (across width, down height), turned by the angle and put about the placement's middle.

    `image`: a frame at 1 / scale of its size, its border repeated.
    """
    point = (across * placement[2] + 1j * down * placement[3]) * np.exp(1j * turn_rad) + complex(*placement[:2])
    x = np.clip((point.real - (scale - 1) / 2) / scale, 0, image.shape[1] - 1.001)
    y = np.clip((point.imag - (scale - 1) / 2) / scale, 0, image.shape[0] - 1.001)
    column, row = x.astype(int), y.astype(int)
    grey = image.astype(float)
    above = grey[row, column] * (1 - x + column) + grey[row, column + 1] * (x - column)
    below = grey[row + 1, column] * (1 - x + column) + grey[row + 1, column + 1] * (x - column)
    return np.asarray(above * (1 - y + row) + below * (y - row))
