"""A vocabulary of binary descriptors: a picture becomes a bag of visual words.

The tree is a hierarchical clustering of 256-bit descriptors in Hamming space: every node has `branching` children, each
the bitwise majority of its own part of the training descriptors (k-majority). To look a descriptor up is to go down to
the nearest child, level by level; the leaf is its word. A word's weight is its inverse document frequency over the
training pictures, and a picture is the vector of weight times count over its words, scaled so that it sums up to 1.

The project's own vocabulary lies beside this module (`base_station.evaluation.vocabulary_training` made it from
generated pictures). Sources: Nister and Stewenius, Scalable recognition with a vocabulary tree, CVPR 2006; Galvez-Lopez
and Tardos, Bags of binary words for fast place recognition in image sequences, T-RO 2012.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from base_station.errors import StationError
from base_station.trackers.slam.popcount import WORDS
from base_station.trackers.slam.vocabulary_kernels import descend, majorities, nearest_center

OWN_VOCABULARY = Path(__file__).with_name("vocabulary.npz")
BYTES = 8 * WORDS
"""Of a descriptor."""
MOST_WORDS = 1 << 20
MOST_FILE_BYTES = 64 << 20


@dataclass(frozen=True, kw_only=True)
class TreeSettings:
    """How a vocabulary is made and read."""

    branching: int = 10
    """Children of a node, 2..64."""
    depth: int = 4
    """Levels below the root, 1..6; the words are branching ** depth."""
    node_level: int = 2
    """The level whose nodes `bow` gives beside the words: descriptors of one node are worth comparing."""
    rounds: int = 12
    """Of the clustering of one node, at the most."""
    seed: int = 0


class Vocabulary:
    """A trained tree. `centers`: (nodes below the root, 4) uint64, level after level; `weights`: (words,) float32."""

    def __init__(
        self, centers: np.ndarray, weights: np.ndarray, *, branching: int, depth: int, node_level: int
    ) -> None:
        """Raises ValueError when the numbers do not fit together."""
        if not (2 <= branching <= 64 and 1 <= depth <= 6 and branching**depth <= MOST_WORDS):
            raise ValueError(f"a tree with {branching} children a node and {depth} levels is not possible")
        if not 1 <= node_level <= depth:
            raise ValueError(f"the level of nodes must be 1..{depth}, not {node_level}")
        nodes = sum(branching**level for level in range(1, depth + 1))
        if centers.shape != (nodes, WORDS) or centers.dtype != np.uint64:
            raise ValueError(f"centers must be ({nodes}, {WORDS}) uint64, not {centers.shape} {centers.dtype}")
        if weights.shape != (branching**depth,) or not (np.isfinite(weights).all() and (weights >= 0).all()):
            raise ValueError(f"weights must be {branching**depth} numbers, none negative")
        self.branching, self.depth, self.node_level = branching, depth, node_level
        self._centers = np.ascontiguousarray(centers)
        self._weights = weights.astype(np.float32)

    @property
    def size(self) -> int:
        """How many words there are."""
        return len(self._weights)

    @property
    def centers(self) -> np.ndarray:
        """(nodes below the root, 4) uint64, level after level."""
        return self._centers

    @property
    def weights(self) -> np.ndarray:
        """(words,) float32."""
        return self._weights

    def bow(self, descriptors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The word, and the node of level `node_level`, of each descriptor: both (n,) int32.

        `descriptors`: (n, 32) uint8; any other shape or type raises ValueError.
        """
        packed = as_words(descriptors)
        words, nodes = np.empty(len(packed), np.int32), np.empty(len(packed), np.int32)
        descend(packed, self._centers, self.branching, self.depth, self.node_level, words, nodes)
        return words, nodes

    def vector(self, words: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A picture's words in rising order without repetition (m,), and their weights (m,) float32, which sum up to 1.

        Words that every training picture has weigh nothing and are left out.
        """
        found, counts = np.unique(words, return_counts=True)
        weights = counts * self._weights[found]
        found, weights = found[weights > 0], weights[weights > 0]
        total = weights.sum()
        return found.astype(np.int32), (weights / total if total else weights).astype(np.float32)

    def similarity(self, words: np.ndarray, others: np.ndarray) -> float:
        """0 (no word in common) to 1 (the same bag) between the words of two pictures: the sum over the words of the
        lesser weight, which is 1 - |a - b| / 2 in the L1 norm."""
        (one, one_weights), (two, two_weights) = self.vector(words), self.vector(others)
        _, at_one, at_two = np.intersect1d(one, two, assume_unique=True, return_indices=True)
        return float(np.minimum(one_weights[at_one], two_weights[at_two]).sum())

    def save(self, path: Path) -> None:
        """Write it as a compressed NumPy file. Weights keep half precision."""
        np.savez_compressed(
            path,
            centers=self._centers,
            weights=self._weights.astype(np.float16),
            shape=np.array([self.branching, self.depth, self.node_level], np.int64),
        )

    @classmethod
    def load(cls, path: Path = OWN_VOCABULARY) -> Vocabulary:
        """Raises StationError when the file is missing or is no vocabulary."""
        try:
            if path.stat().st_size > MOST_FILE_BYTES:
                raise ValueError("it is too large")
            with np.load(path, allow_pickle=False) as file:
                branching, depth, node_level = (int(number) for number in file["shape"])
                weights = file["weights"].astype(np.float32)
                return cls(file["centers"], weights, branching=branching, depth=depth, node_level=node_level)
        except OSError as error:
            raise StationError(f"The vocabulary {path} cannot be read ({error.strerror or error}).") from error
        except (KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise StationError(f"{path} is no vocabulary of visual words: {error}.") from error


def as_words(descriptors: np.ndarray) -> np.ndarray:
    """(n, 32) uint8 to (n, 4) uint64, without a copy where the rows are contiguous. Raises ValueError for any other
    shape or type."""
    if descriptors.ndim != 2 or descriptors.shape[1] != BYTES or descriptors.dtype != np.uint8:
        raise ValueError(f"descriptors must be (n, {BYTES}) uint8, not {descriptors.shape} {descriptors.dtype}")
    return np.ascontiguousarray(descriptors).view(np.uint64)


def train(pictures: Sequence[np.ndarray], settings: TreeSettings | None = None) -> Vocabulary:
    """Make a vocabulary of the descriptors of many pictures, each (n, 32) uint8. The same input gives the same tree.

    Raises ValueError when there is not a descriptor for every child of the root.
    """
    settings = settings or TreeSettings()
    packed = (
        np.concatenate([as_words(picture) for picture in pictures]) if pictures else np.empty((0, WORDS), np.uint64)
    )
    if len(packed) < settings.branching:
        raise ValueError(f"{len(packed)} descriptors are too few for {settings.branching} branches")
    rng = np.random.default_rng(settings.seed)
    levels, parts = [], [np.arange(len(packed))]
    for _ in range(settings.depth):
        centers, below = [], []
        for part in parts:
            found, owners = _split(packed[part], settings, rng)
            centers.append(found)
            below += [part[owners == child] for child in range(settings.branching)]
        levels.append(np.concatenate(centers))
        parts = below
    tree = np.concatenate(levels)
    shape = {"branching": settings.branching, "depth": settings.depth, "node_level": settings.node_level}
    words = settings.branching**settings.depth
    unweighted = Vocabulary(tree, np.ones(words, np.float32), **shape)
    seen_in = np.zeros(words)
    for picture in pictures:
        seen_in[np.unique(unweighted.bow(picture)[0])] += 1
    return Vocabulary(tree, np.log((len(pictures) + 1) / (seen_in + 1)).astype(np.float32), **shape)


def _split(packed: np.ndarray, settings: TreeSettings, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Cluster one node's descriptors: centers (branching, 4), and the center of each descriptor.

    With fewer distinct descriptors than branches the last one is repeated: of equals the first wins, so nothing ever
    comes to a copy. A node without descriptors gets zeros, which nothing comes to either.
    """
    centers = np.zeros((settings.branching, WORDS), np.uint64)
    owners = np.zeros(len(packed), np.int32)
    distinct = np.unique(packed, axis=0)
    if len(distinct) <= settings.branching:
        centers[: len(distinct)] = distinct
        centers[len(distinct) :] = distinct[-1] if len(distinct) else 0
        nearest_center(packed, centers, owners)
        return centers, owners
    centers[:] = distinct[_spread_out(distinct, settings.branching, rng)]
    least = np.inf
    for _ in range(settings.rounds):
        total = nearest_center(packed, centers, owners)
        if total >= least:
            break
        least = total
        majorities(packed, owners, centers)
    nearest_center(packed, centers, owners)
    return centers, owners


def _spread_out(distinct: np.ndarray, count: int, rng: np.random.Generator) -> list[int]:
    """First centers far from one another: each drawn with the squared distance to those before it (k-means++)."""
    sample = rng.choice(len(distinct), min(len(distinct), 2000), replace=False)
    candidates = distinct[sample]
    chosen = [int(rng.integers(len(candidates)))]
    nearest = np.full(len(candidates), np.inf)
    for _ in range(count - 1):
        bits = np.bitwise_count(candidates ^ candidates[chosen[-1]]).sum(1).astype(float)
        nearest = np.minimum(nearest, bits**2)
        chosen.append(int(rng.choice(len(candidates), p=nearest / nearest.sum())))
    return [int(sample[number]) for number in chosen]
