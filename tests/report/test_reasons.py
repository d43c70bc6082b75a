"""The sentences that say why an object was reported, and as what."""

from scenediff_classic.report.reasons import reasons
from scenediff_classic.types import ChangedObject, Kind, Match, PairScore, Support, TermScores

SUPPORT = Support(12, 9, (PairScore("after", 4, 2, 0.512),))


def told(kind: Kind, support: Support | None, match: Match | None) -> str:
    terms = TermScores(0, 0, 0)
    item = ChangedObject(1, kind, 0.5, None, None, None, None, terms, (), support, match)
    return " ".join(reasons(item))


def test_comparisons_are_counted_and_the_clearest_is_named() -> None:
    text = told("added", SUPPORT, None)
    assert "9 of 12" in text
    assert "after 4 against before 2 (score 0.51)" in text
    assert "Nothing else changed in the other capture" in text


def test_a_method_that_records_nothing_says_nothing() -> None:
    assert told("added", None, None) == ""


def test_moved_and_why_not() -> None:
    assert "look alike (0.97, 0.93 needed), sizes 1.2 : 1" in told(
        "moved", SUPPORT, Match(0.97, 0.93, 1.2, 2.5)
    )
    assert "looks different (0.40, 0.93 needed)" in told(
        "added", SUPPORT, Match(0.4, 0.93, 1.2, 2.5)
    )
    assert "sizes 4.0 : 1, at most 2.5 : 1" in told("removed", SUPPORT, Match(0.97, 0.93, 4, 2.5))
    assert "matches another object better" in told("added", SUPPORT, Match(0.97, 0.93, 1, 2.5))
