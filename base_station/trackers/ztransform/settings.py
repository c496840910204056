"""When the tracker believes that it sees its target, and the settings of the stages below it."""

from __future__ import annotations

from dataclasses import dataclass, field

from base_station.trackers.ztransform.loose import LooseSettings
from base_station.trackers.ztransform.recollection import RecollectionSettings
from base_station.trackers.ztransform.rigid import RigidSettings


@dataclass(frozen=True, kw_only=True)
class ZTransformSettings:
    """When to believe, and the settings of the stages."""

    keep_confidence: float = 0.35
    """While tracking, a resemblance below this is not the target, however slowly it came to look so."""
    regain_confidence: float = 0.65
    """After it was lost, a resemblance below this is not the target yet."""
    keep_of_usual: float = 0.6
    """While tracking, a resemblance below this share of the usual is not the target: what vanishes does so suddenly."""
    linger_s: float = 0.5
    """After a loss, for so long it is also looked for where it was, on the terms of tracking."""
    surprise: float = 0.12
    """A resemblance by this much below the usual is looked into: perhaps the true place is another."""
    least_share: float = 0.35
    """Of the target that must lie in the frame."""
    least_texture: float = 1.5
    """Grey levels; a view with less is featureless."""
    above_noise: float = 1.4
    """To be learned, texture must exceed what the pixels' noise alone gives so many times. Walls with noise reached
    1.32; the least of 26 filmed or made-up targets had 1.78, of 270 cuts out of photographs with anything in them
    1.58."""
    smallest_side_px: float = 10.0
    """Of the target, to be learned or tracked."""
    largest_share: float = 3.0
    """Of the frame's width; a target that looks wider than that is too near."""
    firm: float = 0.8
    """A resemblance from which on the signature alone decides. Below, the target may have changed its shape."""
    uncovered: float = 0.85
    """Of the target that must look as it was learned, or the loose follower does not learn from it."""
    firm_aspects: tuple[float, float] = (0.8, 1.15)
    """Width against height, both against the learned ones, of a target that is seen firm before it is proven. Turning
    makes it narrower; what makes it wider, or that narrow so early, is a loose target that pulls the signature."""
    needs_no_second: float = 0.8
    """A resemblance from which on a jump needs not the loose follower's agreement, which knows no covered parts."""
    near: float = 0.3
    """In sides of the target: few move further from one frame to the next."""
    far_sharpness: float = 8.5
    """What an answer elsewhere, or to a search, must have to be the loose target's..."""
    again_sharpness: float = 7.5
    """... or else one in the frame after it, near to it."""
    hold_sharpness: float = 5.0
    """A loose target that looks less sharp than it must to be learned is followed down to this, nothing learned."""
    proven_frames: int = 60
    """A target that was seen firm so often is taken for rigid: what changes suddenly is then something before it."""
    reconsider_s: float = 1.0
    """After so long without a firm look, a proven target is taken for a loose one all the same, if that one is seen."""
    loose_every: int = 30
    """While a proven target is seen firm, the loose follower learns from every so many frames only..."""
    loose_times: int = 7
    """... and then as much as from so many."""
    rigid_every: int = 5
    """While it is seen loose, the signature is tried in every so many frames only: it rarely helps then."""
    search_every: int = 4
    """While a proven target looks as usual, though not firm, it is searched for in every so many frames only."""
    lost_search_every: int = 4
    """While a loose target is lost, it is searched for as a rigid one in every so many frames only."""
    hold_share: float = 0.8
    """Of it that must lie in the frame meanwhile: what leaves the frame is let go."""
    rigid: RigidSettings = field(default_factory=RigidSettings)
    """Following what keeps its shape."""
    loose: LooseSettings = field(default_factory=LooseSettings)
    """Following what does not."""
    recollection: RecollectionSettings = field(default_factory=RecollectionSettings)
    """Noticing that the latter follows something else."""
