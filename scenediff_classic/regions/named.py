"""Every classical region back-end by its name."""

from typing import Literal

from scenediff_classic.protocols import RegionProposer
from scenediff_classic.regions.boundary_merging import BoundaryMergingRegions
from scenediff_classic.regions.things_on_supports import ThingsOnSupportsRegions

RegionName = Literal["boundary-merging", "things-on-supports"]

REGIONS: dict[RegionName, RegionProposer] = {
    "boundary-merging": BoundaryMergingRegions(),
    "things-on-supports": ThingsOnSupportsRegions(),
}
