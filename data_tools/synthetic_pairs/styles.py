"""Which families of textures and objects a split may draw from.

`VAL` and `TEST` have no family in common, so that nothing can be tuned to the test scenes.
"""

from dataclasses import dataclass, replace

from data_tools.synthetic_pairs import objects, objects_held_out, prints, surfaces
from data_tools.synthetic_pairs.models import Builder
from data_tools.synthetic_pairs.surfaces import Family


@dataclass(frozen=True)
class Style:
    """The families of one split."""

    floors: tuple[Family, ...]
    walls: tuple[Family, ...]
    woods: tuple[Family, ...]
    rugs: tuple[Family, ...]
    posters: tuple[Family, ...]
    prints: tuple[Family, ...]
    covers: tuple[Family, ...]
    table_objects: tuple[Builder, ...]
    floor_objects: tuple[Builder, ...]

    def without_texture(self) -> "Style":
        """Even walls and plain objects; floor and posters stay, or no camera could be found."""
        return replace(
            self, walls=(prints.flat_paint,), prints=(prints.glazed,), covers=(prints.glazed,)
        )


VAL = Style(
    floors=(surfaces.planks, surfaces.tiles, surfaces.concrete),
    walls=(surfaces.plaster, surfaces.striped_paper, surfaces.panelling),
    woods=(surfaces.walnut, surfaces.worn_paint),
    rugs=(surfaces.diamond_rug,),
    posters=(prints.shapes_poster,),
    prints=(prints.label, prints.stripes, prints.speckle, prints.painted_leaves),
    covers=(prints.cover,),
    table_objects=objects.TABLE,
    floor_objects=objects.FLOOR,
)

TEST = Style(
    floors=(surfaces.herringbone, surfaces.terrazzo, surfaces.carpet),
    walls=(surfaces.brick, surfaces.stucco, surfaces.dotted_paper),
    woods=(surfaces.butcher_block, surfaces.marble),
    rugs=(surfaces.striped_rug,),
    posters=(prints.landscape_poster,),
    prints=(prints.checks, prints.zigzag, prints.camouflage),
    covers=(prints.stamp,),
    table_objects=objects_held_out.TABLE,
    floor_objects=objects_held_out.FLOOR,
)
