"""Why an object was reported, and as what, in plain sentences."""

from scenediff_classic.types import ChangedObject, Match, Support


def reasons(item: ChangedObject) -> tuple[str, ...]:
    """What a reader should know before believing an object; empty where nothing was recorded."""
    found = []
    if item.support is not None and item.support.compared:
        found.append(_comparisons(item.support))
    if item.kind == "moved" and item.match is not None:
        found.append(_moved(item.match))
    elif item.match is not None:
        found.append(_not_moved(item.match))
    elif item.support is not None:  # the method does look for counterparts
        found.append("Nothing else changed in the other capture, so it did not move.")
    return tuple(found)


def _comparisons(support: Support) -> str:
    text = f"Changed in {support.above} of {support.compared} comparisons of two frames"
    if not support.strongest:
        return f"{text}."
    best = support.strongest[0]
    opposite = "after" if best.video == "before" else "before"
    return (
        f"{text}, most clearly in {best.video} {best.frame} against {opposite} {best.other} "
        f"(score {best.score:.2f})."
    )


def _moved(match: Match) -> str:
    return (
        f"Called moved: both places look alike ({match.similarity:.2f}, {match.least:.2f} needed)"
        f"{_sizes(match)}."
    )


def _not_moved(match: Match) -> str:
    if match.similarity <= match.least:
        return (
            "Not called moved: the likeliest counterpart looks different "
            f"({match.similarity:.2f}, {match.least:.2f} needed)."
        )
    if match.most > 0 and not 0 < match.size_ratio <= match.most:
        return (
            "Not called moved: the likeliest counterpart looks alike "
            f"({match.similarity:.2f}){_sizes(match)}, at most {match.most:.1f} : 1 allowed."
        )
    return "Not called moved: its likeliest counterpart matches another object better."


def _sizes(match: Match) -> str:
    return f", sizes {match.size_ratio:.1f} : 1" if match.size_ratio > 0 else ""
