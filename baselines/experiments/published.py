"""Figures of the paper, kept in tables of their own: other data, other machines, other authors."""

from baselines.experiments.tables import Column, Table, texts

_PAPER = "SceneDiff: A Benchmark and Method for Multiview Object Change Detection"
_APART = (
    f"As printed in the paper ({_PAPER}), never computed here. Do not compare them with figures "
    "on other data."
)
_SCENEDIFF = ("px/im IoU", "obj/im AP", "obj/sc AP", "type-aware")
_SD_V = (
    ("SceneDiff", 39.1, 43.8, 22.8, 18.5),
    ("3DGS-CD", 14.7, 1.0, 0.5, 0.3),
    ("VLM", 22.9, 7.1, 5.3, 2.5),
    ("MV3DCD", 22.1, None, None, None),
    ("CYWS-2D", None, 19.4, None, None),
    ("CYWS-2D, fine-tuned", None, 24.5, None, None),
    ("CYWS-3D", None, 13.9, None, None),
)
_SD_K = (
    ("SceneDiff", 20.8, 20.9, 10.6, 7.7),
    ("3DGS-CD", 4.8, 0.1, 0.1, 0.1),
    ("VLM", 12.4, 3.6, 2.1, 1.5),
    ("MV3DCD", 9.1, None, None, None),
    ("CYWS-2D", None, 9.0, None, None),
    ("CYWS-2D, fine-tuned", None, 16.8, None, None),
    ("CYWS-3D", None, 6.6, None, None),
)
_PASLCD = (
    ("SceneDiff", 47.3), ("MV3DCD", 46.1), ("CYWS-2D", 27.3), ("SplatPose", 17.3),
    ("CSCDNet", 12.5),
)  # fmt: skip
_RC3D = (
    ("SceneDiff", 65.3, 72.3, 59.1), ("CYWS-3D", 41.0, None, None),
    ("CYWS-3D, sensor depth", 50.0, None, None), ("CYWS-2D", 14.0, None, None),
)  # fmt: skip
_CHANGESIM = (
    ("SceneDiff", 57.0), ("GeSCF", 54.8), ("C-3PO", 44.7), ("CSCDNet", 43.1),
    ("CDResNet", 41.3), ("DR-TANet", 40.3),
)  # fmt: skip
_ABLATION = (
    ("pi3 + DINOv3, all cues", "39.1", "43.8", "22.8"),
    ("pi3 + DINOv2", "+0.4", "+1.3", "-1.5"), ("pi3 + DINOv1", "-3.0", "+1.5", "-2.7"),
    ("VGGT + DINOv3", "-2.2", "-8.1", "-8.7"), ("FASt3R + DINOv3", "-23.7", "-39.8", "-22.4"),
    ("geometry cue only", "+2.1", "-12.1", "-10.3"), ("feature cue only", "-6.1", "+0.1", "0.0"),
    ("region cue only", "-14.8", "-14.2", "-0.8"), ("geometry + feature", "-1.8", "-0.1", "+0.1"),
    ("geometry + region", "-1.0", "-6.9", "-5.0"), ("feature + region", "-4.5", "+0.9", "+2.6"),
)  # fmt: skip
_SECONDS = (
    ("SceneDiff", "159.4"), ("VLM", "30.5"), ("CYWS-2D", "18.4"), ("CYWS-3D", "23.9"),
    ("3DGS-CD", "> 1800"), ("MV3DCD", "> 1800"),
)  # fmt: skip


def published_tables(kind: str, *, ablation: bool = False) -> tuple[Table, ...]:
    """What the paper prints for a kind of benchmark.

    For kinds that the paper does not have, its main tables, so that the order of the methods can
    be looked up.

    Parameters
    ----------
    ablation : bool
        Whether the paper's ablation is wanted beside them.
    """
    return (*_comparison(kind), *((_ablation(),) if ablation else ()))


def _comparison(kind: str) -> tuple[Table, ...]:
    known = {
        "paslcd": (_table("paslcd", "PASLCD", ("mIoU",), _PASLCD),),
        "rc3d": (_table("rc3d", "RC-3D", ("AP50 both", "present", "absent"), _RC3D),),
        "changesim": (_table("changesim", "ChangeSim", ("F1",), _CHANGESIM),),
    }
    main = (
        _table("sd-v", "SceneDiff Benchmark, Varied (SD-V)", _SCENEDIFF, _SD_V),
        _table("sd-k", "SceneDiff Benchmark, Kitchen (SD-K)", _SCENEDIFF, _SD_K),
    )
    return known.get(kind.replace("-", "").replace("_", ""), main)


def published_seconds() -> Table:
    """Seconds that the paper gives for a pair."""
    columns = (Column("method", number=False), Column("seconds a pair"))
    return Table(
        "published-seconds", "Published: time", "one NVIDIA A40", columns,
        tuple(texts(*row) for row in _SECONDS), (_APART,),
    )  # fmt: skip


def _ablation() -> Table:
    columns = (Column("variant", number=False), *(Column(name) for name in _SCENEDIFF[:3]))
    what = "SD-V, official mode, percent; below the first row: differences from it"
    rows = tuple(texts(*row) for row in _ABLATION)
    return Table(
        "published-ablation", "Published: ablation of SceneDiff", what, columns, rows, (_APART,)
    )


def _table(
    key: str, benchmark: str, headings: tuple[str, ...], rows: tuple[tuple[object, ...], ...]
) -> Table:
    columns = (Column("method", number=False), *(Column(heading) for heading in headings))
    return Table(
        f"published-{key}", f"Published: {benchmark}", "official mode, percent", columns,
        tuple(texts(*("\N{EN DASH}" if v is None else v for v in row)) for row in rows), (_APART,),
    )  # fmt: skip
