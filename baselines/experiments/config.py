"""What an experiment compares: one TOML file, read into frozen dataclasses."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from baselines.experiments.typed import read_as
from scenediff_classic.errors import InputError
from scenediff_classic.features.named import FeatureName
from scenediff_classic.presets import Preset, StereoMethod
from scenediff_classic.regions.named import RegionName

EXAMPLES = Path(__file__).with_name("configs")
"""Configurations that come with the package."""

_FIT = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+=-]*")


@dataclass(frozen=True)
class BenchmarkSpec:
    """Pairs to compare on."""

    kind: str
    """As `data_tools.benchmarks.named.open_benchmark` calls it."""
    root: Path
    """Folder of the data, from the current folder if it is relative."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of the benchmark, such as a split."""
    limit: int | None = None
    """Only the first so many pairs."""
    scenes: tuple[str, ...] = ()
    """Only the pairs of these names."""


@dataclass(frozen=True)
class MethodSpec:
    """A method to compare."""

    name: str
    """As tables call it."""
    method: str | None = None
    """Its name in `baselines.registry`, or ``module:attribute``; the same as `name` if left out."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Dotted name -> value, for its own configuration."""

    @property
    def registered(self) -> str:
        """What `baselines.registry.load_method` takes."""
        return self.method or self.name


@dataclass(frozen=True)
class Setting:
    """Conditions under which methods are compared."""

    name: str = "default"
    geometry: Literal["estimated", "known"] = "estimated"
    """From the pictures, or what the benchmark gives."""
    preset: Preset = "balanced"
    long_side: int | None = None
    """Longer side of the working pictures, in pixels; as the preset has it if left out."""
    stereo: StereoMethod | None = None
    """How depth is matched; as the preset has it if left out."""
    geometry_options: Mapping[str, Any] = field(default_factory=dict)
    """Dotted name -> value, for the source of geometry."""
    features: FeatureName | None = None
    """What the core takes unless a method's options say otherwise."""
    regions: RegionName | None = None
    learned_features: str | None = None
    """Weights of a DINO model for the core."""
    learned_regions: str | None = None
    """Weights of a SAM model for the core."""
    methods: tuple[str, ...] = ()
    """Only these; all if empty."""
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Method -> dotted name -> value, over the options of the method itself."""


@dataclass(frozen=True)
class Sweep:
    """One option of a method over several values: a setting for each, ``<option>=<value>``."""

    method: str
    option: str
    """Dotted name."""
    values: tuple[Any, ...]
    like: str = "default"
    """The setting in which all else is as it was."""


@dataclass(frozen=True)
class ExperimentConfig:
    """Methods x pairs x settings."""

    name: str
    benchmarks: tuple[BenchmarkSpec, ...]
    methods: tuple[MethodSpec, ...]
    settings: tuple[Setting, ...] = (Setting(),)
    sweeps: tuple[Sweep, ...] = ()
    seed: int = 0
    share: tuple[Literal["regions", "features"], ...] = ("regions", "features")
    """What methods share beside geometry. Nothing, where times and memory are to be measured."""
    draws: int = 1000
    """Of pairs, for the intervals."""
    figures: bool = True
    """Write tables and figures at the end."""

    def selected(
        self, methods: Sequence[str] = (), scenes: Sequence[str] = (), limit: int | None = None
    ) -> "ExperimentConfig":
        """A part of the experiment.

        Raises
        ------
        InputError
            If it has no such method, or the limit is not positive.
        """
        if limit is not None and limit < 1:
            raise InputError(f"--limit must be at least 1, not {limit}.")
        config = self
        if methods:
            have = [m.name for m in self.methods]
            for name in methods:
                if name not in have:
                    raise InputError(f"--methods: there is no '{name}', only {', '.join(have)}.")
            config = replace(config, methods=tuple(m for m in self.methods if m.name in methods))
        benchmarks = tuple(
            replace(
                b,
                scenes=tuple(scenes) or b.scenes,
                limit=min(limit or b.limit or 0, b.limit or limit or 0) or None,
            )
            for b in self.benchmarks
        )
        return replace(config, benchmarks=benchmarks)

    def in_setting(self, setting: Setting) -> tuple[MethodSpec, ...]:
        """The methods that are compared there."""
        return tuple(m for m in self.methods if not setting.methods or m.name in setting.methods)


def read_config(source: Path) -> ExperimentConfig:
    """An experiment from a TOML file, or from the name of one that comes with the package.

    Raises
    ------
    InputError
        If the file is no TOML, has an unknown key or a value of the wrong type, or contradicts
        itself.
    """
    shipped = EXAMPLES / f"{source}.toml"
    path = shipped if not source.exists() and shipped.is_file() else source
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        examples = ", ".join(sorted(p.stem for p in EXAMPLES.glob("*.toml")))
        raise InputError(
            f"{source} cannot be read ({error.strerror}): give a TOML file, or one of {examples}."
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not valid TOML: {error}.") from error
    return checked(read_as(ExperimentConfig, content, str(path)), str(path))


def checked(config: ExperimentConfig, where: str) -> ExperimentConfig:
    """The configuration with sweeps as settings, if it makes sense as a whole.

    Raises
    ------
    InputError
        With one sentence on what does not.
    """
    settings = (*config.settings, *(s for sweep in config.sweeps for s in _swept(config, sweep)))
    config = replace(config, settings=settings, sweeps=())
    for kind, items in (
        ("benchmarks", config.benchmarks), ("methods", config.methods), ("settings", settings)
    ):  # fmt: skip
        if not items:
            raise InputError(f"{where} names no {kind}: add [[{kind}]].")
    methods = [m.name for m in config.methods]
    for kind, names in (("method", methods), ("setting", [s.name for s in settings])):
        for name in names:
            if not _FIT.fullmatch(name):
                raise InputError(f"{where}: the {kind} '{name}' cannot be the name of a folder.")
            if names.count(name) > 1:
                raise InputError(f"{where}: two {kind}s are called '{name}'.")
    for setting in settings:
        for name in (*setting.methods, *setting.options):
            if name not in methods:
                raise InputError(
                    f"{where}: the setting '{setting.name}' names the method '{name}', which is "
                    f"none of {', '.join(methods)}."
                )
    for low, name, value in ((10, "draws", config.draws), (0, "seed", config.seed)):
        if value < low:
            raise InputError(f"{where}: {name} must be at least {low}, not {value}.")
    for benchmark in config.benchmarks:
        if benchmark.limit is not None and benchmark.limit < 1:
            raise InputError(f"{where}: limit must be at least 1, not {benchmark.limit}.")
    return config


def _swept(config: ExperimentConfig, sweep: Sweep) -> list[Setting]:
    base = next((s for s in config.settings if s.name == sweep.like), None)
    if base is None:
        raise InputError(f"A sweep is like the setting '{sweep.like}', which is not there.")
    out = []
    for value in sweep.values:
        options = {**base.options.get(sweep.method, {}), sweep.option: value}
        name = f"{sweep.option}={value}"
        out.append(
            replace(
                base, name=name, methods=(sweep.method,),
                options={**base.options, sweep.method: options},
            )
        )  # fmt: skip
    return out
