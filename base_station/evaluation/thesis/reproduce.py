"""scripts/reproduce-thesis: the thesis's figures and its comparison, into one folder with an index page."""

from __future__ import annotations

import argparse
import os
import platform
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.progress import Progress

from base_station.errors import StationError
from base_station.evaluation.thesis import comparison, comparison_plates, method_plates, region_plates, shift_plates
from base_station.evaluation.thesis.comparison import CASES, Case, Tally
from base_station.evaluation.thesis.page import page
from base_station.evaluation.thesis.pictures import SCENES, read_pictures, room
from base_station.evaluation.thesis.plotting import DARK, LIGHT, Plate, require, save
from base_station.evaluation.thesis.transform_plates import fourier_and_z, laplace_cells, row_and_transform

EXIT_DONE, EXIT_FAILED, EXIT_USAGE = 0, 1, 2
LARGEST_SEED = 2**31 - 1


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How much is measured and how finely drawn."""

    pictures: int
    """In the experiments of chapter 4."""
    scene_pictures: int
    """Per case of the comparison."""
    cases: tuple[Case, ...]
    frames: int
    jumps: int
    dpi: int
    dark: bool
    """Every figure a second time, for a dark page."""
    tidy: bool
    """See `save`."""


FULL = Effort(pictures=20, scene_pictures=3, cases=CASES, frames=60, jumps=10, dpi=140, dark=True, tidy=True)
QUICK = Effort(
    pictures=1, scene_pictures=1, cases=(CASES[0], CASES[-1]), frames=4, jumps=1, dpi=50, dark=False, tidy=False
)
README_DPI = 90


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 done, 1 failed, 2 wrong usage."""
    parser = argparse.ArgumentParser(prog="scripts/reproduce-thesis", description=__doc__.partition(": ")[2])
    parser.add_argument("--out", type=Path, default=Path("thesis-figures"), help="folder for figures and index.html")
    parser.add_argument("--images", type=Path, help="use these pictures instead of seeded rooms (up to 24)")
    parser.add_argument("--seed", type=int, default=0, help="of the seeded pictures (default 0)")
    parser.add_argument("--quick", action="store_true", help="a few frames and coarse figures, to see that it works")
    parser.add_argument("--readme", type=Path, metavar="DIR", help="write the README's figures here as well")
    try:
        options = parser.parse_args(arguments)
    except SystemExit as end:  # argparse has said why, or has shown the help
        return EXIT_USAGE if end.code else EXIT_DONE
    console, effort = Console(stderr=True), QUICK if options.quick else FULL
    try:
        if not 0 <= options.seed <= LARGEST_SEED:
            raise StationError(f"--seed {options.seed}: choose 0..{LARGEST_SEED}", usage=True)
        require()
        own = read_pictures(options.images) if options.images else None
        for folder in (options.out, options.readme):
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
        _make(options, effort, own, list(sys.argv[1:] if arguments is None else arguments), console)
    except KeyboardInterrupt:
        console.print("reproduce-thesis: interrupted; the folder is not complete", style="red")
        return EXIT_FAILED
    except (StationError, OSError) as error:
        console.print(f"reproduce-thesis: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        return EXIT_USAGE if getattr(error, "usage", False) else EXIT_FAILED
    console.print(f"reproduce-thesis: open {options.out / 'index.html'}", highlight=False, soft_wrap=True)
    return EXIT_DONE


def _make(
    options: argparse.Namespace, effort: Effort, own: list[np.ndarray] | None, arguments: list[str], console: Console
) -> None:
    cv2.setNumThreads(1)
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("chapters 2 and 4", total=14 + len(effort.cases) + 3)
        sections: list[tuple[str, list[Plate]]] = []
        chapters = _chapters(effort, own, options.seed)
        plates: list[Plate] = []
        for heading, plate in chapters:
            if not sections or sections[-1][0] != heading:
                plates = []
                sections.append((heading, plates))
            plates.append(plate)
            progress.advance(task)
        progress.update(task, description="the comparison")
        results: dict[str, dict[str, Tally]] = {}
        trackers = comparison.contenders()
        for case in effort.cases:
            pictures = comparison.scene_pictures(case, own, seed=options.seed, count=effort.scene_pictures)
            results[case.name] = comparison.run_case(case, pictures, trackers, frames=effort.frames, seed=options.seed)
            progress.advance(task)
        rooms = comparison.scene_pictures(CASES[0], own, seed=options.seed, count=effort.scene_pictures)
        curves = comparison.run_light(rooms, trackers, seed=options.seed, jumps=effort.jumps)
        progress.advance(task)
        shown = {name: make(options.seed) for name, (make, _) in SCENES.items()} | ({"room": own[0]} if own else {})
        compared = [
            comparison_plates.scenes(shown),
            comparison_plates.answers(results, effort.frames * effort.scene_pictures),
            comparison_plates.brightness(curves),
            comparison_plates.cost(results),
        ]
        sections.append(("The comparison: chapters 4 and 5", compared))
        progress.update(task, description="drawing")
        _draw_all([plate for _, plates in sections for plate in plates], options, effort)
        progress.advance(task)
    text = page(sections, results, _facts(options, effort, arguments), dark=effort.dark)
    (options.out / "index.html").write_text(text, encoding="utf-8")


def _chapters(effort: Effort, own: list[np.ndarray] | None, seed: int) -> Iterator[tuple[str, Plate]]:
    """Heading and figure, one after another, measured as they are asked for."""
    pictures = own[: effort.pictures] if own else [room(seed + number) for number in range(effort.pictures)]
    first = pictures[0]
    transforms = "The transform: chapters 2 and 3"
    yield transforms, fourier_and_z()
    yield transforms, laplace_cells()
    yield transforms, row_and_transform(first)
    solving = "Solving for the shift: algorithm 4.1"
    for plate in shift_plates.two_images(first, -10, number=2):
        yield solving, plate
    yield solving, shift_plates.equation_solving(first)
    yield solving, shift_plates.causes(pictures)
    yield solving, shift_plates.which_z(pictures)
    regions = "Which region changed: algorithm 4.2"
    for plate in shift_plates.two_images(first, -20, number=5):
        yield regions, plate
    yield regions, region_plates.greatest_change(pictures)
    yield regions, region_plates.moving_thing(pictures[:6])
    method = "The method that came of it"
    yield method, method_plates.windows()
    yield method, method_plates.recursion(first)
    yield method, method_plates.zoom()


def _draw_all(plates: list[Plate], options: argparse.Namespace, effort: Effort) -> None:
    for plate in plates:
        save(plate, options.out / f"{plate.name}.png", LIGHT, dpi=effort.dpi, tidy=effort.tidy)
        if effort.dark:
            save(plate, options.out / f"{plate.name}-dark.png", DARK, dpi=effort.dpi, tidy=effort.tidy)
        if options.readme is not None and plate.for_readme:
            save(plate, options.readme / f"{plate.name}.png", LIGHT, dpi=README_DPI)


def _facts(options: argparse.Namespace, effort: Effort, arguments: list[str]) -> dict[str, str]:
    packages = ", ".join(
        f"{name} {version(name)}" for name in ("numpy", "opencv-python-headless", "numba", "matplotlib")
    )
    pictures = f"your own, from {options.images.name}/" if options.images else f"seeded, seed {options.seed}"
    return {
        "command": shlex.join(["scripts/reproduce-thesis", *arguments]),
        "pictures": f"{pictures}; views of 640x480 px, {effort.pictures} pictures for chapter 4",
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}, {packages}",
        "same again": "With the same seed everything but the times comes out the same.",
    }
