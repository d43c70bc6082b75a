"""From a configuration to the cells of the comparison: every method on every pair, per setting."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from baselines.experiments.chosen import Chosen
from baselines.experiments.config import ExperimentConfig, MethodSpec, Setting
from baselines.experiments.overriding import dotted, overridden
from baselines.experiments.store import Fingerprints, pair_stages
from baselines.experiments.tasks import Detect, Outcome, Prepare, read_outcome
from baselines.registry import load_method
from data_tools.benchmarks.benchmark import BenchmarkPair
from data_tools.benchmarks.stages import digest
from scenediff_classic.errors import InputError, SceneDiffError
from scenediff_classic.geometry.known_cameras import KnownGeometry
from scenediff_classic.pipeline import DetectConfig
from scenediff_classic.presets import LONG_SIDE, configured
from scenediff_classic.result.run import json_ready


@dataclass(frozen=True)
class Cell:
    """A method on a pair in a setting."""

    method: str
    setting: str
    benchmark: str
    pair: BenchmarkPair
    task: Detect | None
    """None if it cannot be done at all."""
    problem: str | None = None
    """Why it cannot."""

    @property
    def place(self) -> Path:
        """Of its output below ``results``, and of its record."""
        return place(self.setting, self.method, self.benchmark, self.pair.name)

    def ended(self) -> Outcome | None:
        """How it ended; None if it never did."""
        if self.task is None:
            return Outcome("failed", self.problem)
        return read_outcome(self.task)

    def outcome(self) -> Outcome | None:
        """The same; None also if another try might end in another way."""
        found = self.ended()
        return found if found is not None and found.final else None


def place(setting: str, method: str, benchmark: str, pair: str) -> Path:
    """Where a cell lies, relative to the folder of its kind."""
    return Path(setting, method, benchmark, pair)


def planned(
    config: ExperimentConfig,
    benchmarks: tuple[Chosen, ...],
    run: Path,
    store: Path,
    prints: Fingerprints,
) -> list[Cell]:
    """All cells, in the order of settings, methods, benchmarks and pairs.

    Raises
    ------
    InputError
        If a method is not there or its options are wrong: nothing was started then.
    """
    cells: list[Cell] = []
    for setting in config.settings:
        bases = {c.benchmark.name: list(_bases(config, setting, c)) for c in benchmarks}
        for spec in config.in_setting(setting):
            for chosen in benchmarks:
                for pair, base in zip(chosen.pairs, bases[chosen.benchmark.name], strict=True):
                    names = spec.name, setting.name, chosen.benchmark.name
                    if base is None:
                        problem = f"{chosen.benchmark.name} gives no geometry for {pair.name}."
                        cells.append(Cell(*names, pair, None, problem))
                        continue
                    where = run, store
                    cells.append(_cell(config, setting, spec, chosen, pair, base, where, prints))
    return cells


def _bases(
    config: ExperimentConfig, setting: Setting, chosen: Chosen
) -> Iterator[DetectConfig | None]:
    """The core's options in a setting for every pair; None where a pair lacks geometry."""
    base = configured(
        setting.preset, long_side=setting.long_side, seed=config.seed, stereo=setting.stereo,
        features=setting.features, regions=setting.regions,
        learned_features=setting.learned_features, learned_regions=setting.learned_regions,
    )  # fmt: skip
    side = setting.long_side or LONG_SIDE[setting.preset]
    where = f"The setting '{setting.name}', geometry_options"
    for pair in chosen.pairs:
        if setting.geometry == "known":
            if pair.known_geometry is None:
                yield None
                continue
            source: Any = KnownGeometry(pair.known_geometry, long_side=side)
        else:
            source = base.geometry
        yield replace(base, geometry=overridden(source, setting.geometry_options, where))


def method_config(spec: MethodSpec, setting: Setting, base: DetectConfig, seed: int) -> Any:
    """The options of a method in a setting.

    Raises
    ------
    InputError
        If one is unknown, of the wrong type, or about geometry.
    """
    config = load_method(spec.registered).configured(base, seed)
    varied: Mapping[str, Any] = setting.options.get(spec.name, {})
    for options, where in (
        (spec.options, f"The method '{spec.name}'"),
        (varied, f"The setting '{setting.name}', method '{spec.name}'"),
    ):
        if any(name.partition(".")[0] == "geometry" for name in dotted(options)):
            raise InputError(
                f"{where}: geometry is the same for all methods, so it is an option of settings."
            )
        config = overridden(config, options, where)
    return config


def _cell(
    config: ExperimentConfig, setting: Setting, spec: MethodSpec, chosen: Chosen,
    pair: BenchmarkPair, base: DetectConfig, where: tuple[Path, Path],
    prints: Fingerprints,
) -> Cell:  # fmt: skip
    run, store = where
    names = spec.name, setting.name, chosen.benchmark.name
    own = method_config(spec, setting, base, config.seed)
    known = pair.known_geometry if setting.geometry == "known" else None
    try:
        captures = prints.capture(pair.before), prints.capture(pair.after)
        identity = captures if known is None else (*captures, prints.tree(known))
        files = [prints.tree(path) for path in load_method(spec.registered).files(own)]
    except SceneDiffError as error:  # of this pair: the others are still to be done
        return Cell(*names, pair, None, " ".join(str(error).split()))
    stages = pair_stages(pair, identity, store)
    prepare = Prepare(
        key=digest(identity, stages.key(base.geometry)),
        label=f"{setting.name} / geometry / {pair.name}",
        pair=pair, identity=identity, source=base.geometry, store=store,
    )  # fmt: skip
    text = json.dumps(json_ready(own), sort_keys=True)
    if known is not None:
        text = text.replace(json.dumps(str(known))[1:-1], "<known>")
    key = digest(
        version("scenediff-classic"), spec.registered, text, identity, files, sorted(config.share)
    )
    below = place(setting.name, spec.name, chosen.benchmark.name, pair.name)
    task = Detect(
        key=key, label=f"{setting.name} / {spec.name} / {pair.name}", prepare=prepare,
        method=spec.registered, config=own, seed=config.seed, share=config.share,
        out=run / "results" / below, record=run / "records" / below.with_name(f"{pair.name}.json"),
    )  # fmt: skip
    return Cell(*names, pair, task)
