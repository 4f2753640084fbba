"""Every parameter of the package, declared once.

ROS descriptors, the check of YAML files, command lines and the documents' table follow from the
dataclasses below. A parameter's public name is its path, dots between: ``flow.interval``.

Ranges hold what works. Where an end is no plain fact (a count, a fraction), it was tried on a
short clip; values beyond it find nothing, or take background for an object, or take minutes a
second of video.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import logging
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from turbseg_ros.one_line import printable

Value = bool | int | float | str

T = TypeVar("T")

UsedWhen = Mapping[str, tuple[Value, ...]]
"""Other parameters' names, and the values with all of which a parameter is used."""

_LOGGER = logging.getLogger(__name__)
# Names of parameters that were warned about: former ones, and of those that are gone.
_warned_of: set[str] = set()
# Parameters that are gone, and what others do in their place. Files may set them until the next
# minor version.
_REPLACED = {"tracking.travel": "tracking.false_alarms_per_hour"}
# Names every ROS node has, which are the middleware's business and not ours.
_MIDDLEWARE_NAMES = ("use_sim_time", "qos_overrides", "start_type_description_service")


# What is quoted of a file may make up of an error's text.
_MAX_LENGTH = 1000
# Names a class of the user's own: package.module:Class.
_CLASS_NAME = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


class ParameterError(ValueError):
    """A parameter that is unknown, of the wrong type or out of range; the text says which.

    It is one line. Names and values in it may come from a file: what a terminal would obey is
    written out.
    """

    def __init__(self, text: str) -> None:
        super().__init__(printable(text, _MAX_LENGTH))


class UnknownParameterError(ParameterError):
    """A parameter that is not declared; the text names the one that may have been meant."""


@dataclass(frozen=True)
class Declaration:
    """What is known of one parameter."""

    name: str
    default: Value
    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False
    extensible: bool = False
    used_when: UsedWhen = field(default_factory=dict, hash=False)
    node_only: bool = False
    replayed_values: tuple[Value, ...] = ()
    former_names: tuple[str, ...] = ()
    names_file: bool = False

    @property
    def condition(self) -> str:
        """When the parameter is used, as a sentence; empty when it always is."""
        if self.node_only:
            also = (
                f"; {_either(self.replayed_values)} elsewhere too" if self.replayed_values else ""
            )
            return f"Used by the live node only{also}."
        return f"Used only with {_together(self.used_when)}." if self.used_when else ""

    @property
    def type(self) -> type[Value]:
        """The parameter's type: bool, int, float or str."""
        return type(self.default)

    def check(self, value: object) -> Value:
        """Return `value` in the declared type.

        :raises ParameterError: when it has another type, is out of range or is no listed choice.
        """
        if self.type is float and isinstance(value, int) and not isinstance(value, bool):
            try:
                value = float(value)
            except OverflowError:
                raise ParameterError(f"parameter {self.name} is too large") from None
        if type(value) is not self.type:
            raise ParameterError(
                f"parameter {self.name} takes {_article(self.type)}, not {value!r}"
            )
        if self.choices and value not in self.choices and not self._names_class(value):
            own = ", or package.module:Class" if self.extensible else ""
            raise ParameterError(
                f"parameter {self.name} is one of {', '.join(self.choices)}{own}, not {value!r}"
            )
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            low, high = self.minimum, self.maximum
            # Written so that NaN fails too.
            if not ((low is None or value >= low) and (high is None or value <= high)):
                raise ParameterError(
                    f"parameter {self.name} lies between {low} and {high}, not at {value}"
                )
        return value

    def _names_class(self, value: object) -> bool:
        """Whether it names a class of the user's own, where one may stand in for the choices."""
        return self.extensible and bool(_CLASS_NAME.fullmatch(str(value)))


def parameter(
    default: T,
    description: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
    extensible: bool = False,
    used_when: UsedWhen | None = None,
    node_only: bool = False,
    replayed_values: tuple[Value, ...] = (),
    former_names: tuple[str, ...] = (),
    names_file: bool = False,
) -> T:
    """Declare a dataclass field as a parameter.

    :param extensible: whether `package.module:Class` may stand in for one of the choices.
    :param used_when: values of others without which this one has no effect.
    :param node_only: whether only the live node reads it, no tool that replays bags.
    :param replayed_values: of those that only the node reads, values that count in replays too.
    :param former_names: full names that it had; they are taken for it until the next minor
        version, with one warning.
    :param names_file: whether it names a file, which is read anew each time that it is set.
    """
    declared: T = field(
        default=default,
        metadata={
            "description": description,
            "unit": unit,
            "minimum": minimum,
            "maximum": maximum,
            "choices": choices,
            "read_only": read_only,
            "extensible": extensible,
            "used_when": used_when or {},
            "node_only": node_only,
            "former_names": former_names,
            "names_file": names_file,
            "replayed_values": replayed_values,
        },
    )
    return declared


_RAFT: UsedWhen = {"flow.backend": ("raft_small", "raft_large")}
_DIS: UsedWhen = {"flow.backend": ("dis",)}
_BACKGROUND: UsedWhen = {"outline.method": ("background",)}
_KALMAN: UsedWhen = {"tracking.mode": ("kalman",)}
_PRETRAINED: UsedWhen = {"outline.method": ("background",), "refine.mode": ("pretrained",)}
_FITTED_TO_CLIP: UsedWhen = {"refine.mode": ("optimise",)}


@dataclass(frozen=True)
class ResolutionParameters:
    """Sizes that a frame is worked on at, given for a 16:9 picture; others get as many pixels."""

    processing: int = parameter(
        432,
        "Width at which flow and motion are computed.",
        unit="px",
        # Narrower, objects are a few pixels; wider, a second of video takes minutes.
        minimum=128,
        maximum=1920,
        read_only=True,
    )
    detail: int = parameter(
        864,
        "Width at which outlines are drawn, when the input is as wide.",
        unit="px",
        # Narrower, an outline is a few blocks. Wider than the input costs nothing.
        minimum=128,
        maximum=3840,
        read_only=True,
    )


@dataclass(frozen=True)
class LatencyParameters:
    """How long a frame waits for its successors."""

    mode: str = parameter(
        "centred",
        "centred: compare with frames before and after; causal: with earlier ones only.",
        choices=("centred", "causal"),
        read_only=True,
    )
    look_ahead: int = parameter(
        6,
        "Frames after which a result comes, when centred: the more, the steadier motion is "
        "measured, and the earlier an object shows that is known only later.",
        unit="frames",
        # With fewer there is hardly a neighbour ahead; see causal.
        minimum=3,
        maximum=300,
        read_only=True,
        used_when={"latency.mode": ("centred",)},
    )
    warm_up: int = parameter(
        24,
        "Frames that must be there before the first is answered, when centred: they show its "
        "background.",
        unit="frames",
        minimum=0,
        maximum=300,
        read_only=True,
        used_when={"latency.mode": ("centred",)},
    )
    coast_from: int = parameter(
        2,
        "Images that wait when the node begins to shed load: between measurements of motion, "
        "objects then coast instead of being outlined. 0: always; more than queue_size: never.",
        unit="frames",
        minimum=0,
        maximum=1001,
        node_only=True,
        replayed_values=(0,),
        former_names=("latency.haste_from",),
    )
    sparse_from: int = parameter(
        4,
        "Images that wait when motion is measured half as often as flow.every says. 0: always; "
        "more than queue_size: never.",
        unit="frames",
        minimum=0,
        maximum=1001,
        node_only=True,
        replayed_values=(0,),
    )


@dataclass(frozen=True)
class FlowParameters:
    """Optical flow between a frame and its neighbours."""

    backend: str = parameter(
        "dis",
        "dis: OpenCV's dense inverse search; raft_small, raft_large: a network, which needs "
        "torch and torchvision.",
        choices=("dis", "raft_small", "raft_large"),
        read_only=True,
        extensible=True,
    )
    weights: str = parameter(
        "",
        "File with RAFT's weights, of torchvision or of RAFT's authors; empty: torchvision "
        "fetches its own.",
        read_only=True,
        used_when=_RAFT,
    )
    interval: int = parameter(
        4,
        "Largest interval B between a frame and its neighbours, on both sides.",
        unit="frames",
        minimum=1,
        maximum=16,
        read_only=True,
    )
    every: int = parameter(
        4,
        "Every how many frames motion is measured; in between, what moves is propagated. When "
        "causal, twice as often while it is open whether something is an object and no frame "
        "waits.",
        unit="frames",
        minimum=1,
        maximum=8,
        read_only=True,
    )
    average: str = parameter(
        "slope",
        "slope: fit the velocity to the flows at ±B and -3B; mean: the paper's eq. 1, ±1 to ±B.",
        choices=("slope", "mean"),
        read_only=True,
        extensible=True,
        used_when={"motion.measure": ("affine", "none")},
    )
    variational_iterations: int = parameter(
        1,
        "Steps of DIS flow's variational refinement at each scale.",
        minimum=0,
        maximum=10,
        used_when=_DIS,
    )


@dataclass(frozen=True)
class MotionParameters:
    """What counts as breaking the camera's own motion."""

    measure: str = parameter(
        "affine",
        "affine: distance from an affine ego-motion; sampson: Sampson distance under a "
        "fundamental matrix, the paper's eq. 2; none: the flow as it is.",
        choices=("affine", "sampson", "none"),
        read_only=True,
        extensible=True,
    )
    averaging: bool = parameter(
        True,
        "Look at motion averaged over measurements, too, while the camera nearly stands: what "
        "comes closer, or is far away, may be too slow for one.",
        read_only=True,
    )


@dataclass(frozen=True)
class SeedParameters:
    """Which windows of the motion map move significantly."""

    size: int = parameter(
        9,
        "Side D of the window, at processing resolution.",
        unit="px",
        minimum=1,
        # A window that is larger than the objects is nowhere all moving, so that none is found.
        maximum=31,
    )
    delta1: float = parameter(
        5.0,
        "Least mean of the motion map over the window, in units of its noise where nothing moves.",
        # Below the noise itself everything is a seed; few objects stand out so much as the end.
        minimum=1.0,
        maximum=50.0,
    )
    delta2: float = parameter(
        0.5,
        "Largest standard deviation over the window, as a fraction of its mean.",
        # With 0 no window is even enough; 10 asks for nothing.
        minimum=0.05,
        maximum=10.0,
    )
    evidence: float = parameter(
        2.0,
        "Least gain by which the pictures must confirm a window's motion photometrically: how "
        "much less a neighbour differs along the flow than at rest, in units of the picture's "
        "noise. 0: not asked.",
        minimum=0.0,
        maximum=100.0,
    )
    clutter: float = parameter(
        1.0,
        "Factor by which what a place is known to move by without anything being there counts "
        "as noise. 0: not at all.",
        minimum=0.0,
        maximum=100.0,
    )
    standing_out: bool = parameter(
        True,
        "Look as well at what stands out from the scene's past, though flow doesn't show it to "
        "move: what goes too fast for it, or is plain.",
        read_only=True,
        used_when=_BACKGROUND,
    )
    small_targets: bool = parameter(
        True,
        "Follow what stands out from all of its surroundings in each frame, or in its change, and "
        "take it for an object once it has come far enough: what is too small or too slow for "
        "flow, or lies before waves.",
        read_only=True,
    )


@dataclass(frozen=True)
class GrowingParameters:
    """How far a region grows from its seed."""

    similarity: str = parameter(
        "velocity",
        "velocity: pixels that share the seed's velocity; magnitude: its speed, as in eq. 3.",
        choices=("velocity", "magnitude"),
        read_only=True,
        extensible=True,
    )
    delta: float = parameter(
        0.6,
        "Difference from the seed that still belongs to it, as a fraction of the seed's speed.",
        # Below, regions are their seeds. Towards 1 what stands still belongs to every seed, and
        # one region takes the whole picture.
        minimum=0.05,
        maximum=0.8,
    )
    expansion: bool = parameter(
        True,
        "Let regions that share a velocity go on where their motion does, with a scale of its "
        "own: what comes closer or goes.",
        read_only=True,
        used_when={"growing.similarity": ("velocity",)},
    )


@dataclass(frozen=True)
class OutlineParameters:
    """How a moving region is cut out of the picture."""

    method: str = parameter(
        "background",
        "background: what stands out from the median of other frames; none: the grown region.",
        choices=("background", "none"),
        read_only=True,
        extensible=True,
    )
    threshold: float = parameter(
        2.5,
        "Standard deviations from the background that make a pixel part of an object.",
        minimum=0.5,
        maximum=20.0,
        used_when={**_BACKGROUND, "refine.mode": ("none", "optimise")},
    )
    memory: int = parameter(
        48,
        "Age up to which frames show the background.",
        unit="frames",
        minimum=8,
        maximum=1000,
        read_only=True,
        used_when=_BACKGROUND,
    )
    key_step: int = parameter(
        4,
        "Every how many frames one is remembered.",
        unit="frames",
        minimum=1,
        maximum=100,
        read_only=True,
        used_when=_BACKGROUND,
    )


@dataclass(frozen=True)
class RefineParameters:
    """How a network refines outlines."""

    mode: str = parameter(
        "pretrained",
        "pretrained: a small network draws the outlines; none: rules do; optimise: "
        "a network fitted to the whole clip, as in the paper, which needs torch "
        "(turbseg_replay and turbseg_evaluate only).",
        choices=("none", "pretrained", "optimise"),
        read_only=True,
        extensible=True,
    )
    weights: str = parameter(
        "",
        "File with a network for pretrained, refine_net.onnx of turbseg_train; empty: the one "
        "that comes with the package.",
        read_only=True,
        used_when=_PRETRAINED,
    )
    epochs: int = parameter(
        25,
        "Times that optimise goes through the clip before masks are re-grouped.",
        minimum=1,
        maximum=1000,
        read_only=True,
        used_when=_FITTED_TO_CLIP,
    )
    grouping: bool = parameter(
        True,
        "Whether optimise goes on for ten epochs with masks re-grouped by 2-means.",
        read_only=True,
        used_when=_FITTED_TO_CLIP,
    )


@dataclass(frozen=True)
class TrackingParameters:
    """How objects keep their ids."""

    mode: str = parameter(
        "kalman",
        "kalman: live; kmeans: the paper's, which needs the whole clip (turbseg_replay and "
        "turbseg_evaluate only).",
        choices=("kalman", "kmeans"),
        read_only=True,
        extensible=True,
    )
    min_hits: int = parameter(
        4,
        "Frames in which something must be seen moving to become an object.",
        unit="frames",
        minimum=1,
        # Results wait as long.
        maximum=30,
        used_when=_KALMAN,
        former_names=("tracking.confirmation",),
    )
    false_alarms_per_hour: float = parameter(
        1.0,
        "How often what only shimmers may be taken for an object: the lower, the further "
        "something must travel against its own jitter and what its place moves by anyway.",
        unit="1/h",
        minimum=1e-6,
        maximum=1e6,
        used_when=_KALMAN,
    )
    max_age: int = parameter(
        30,
        "Frames for which an object may be lost, or stand still where the picture doesn't show "
        "it, before it ends; twice flow.every at least.",
        unit="frames",
        # Between two measurements of motion, under load twice flow.every apart, all seem still.
        minimum=8,
        maximum=100000,
        used_when=_KALMAN,
        former_names=("tracking.patience",),
    )
    stopped: float = parameter(
        60.0,
        "Seconds for which an object that stopped is reported as long as the picture shows it, "
        "before it is background; 0: for tracking.max_age only.",
        unit="s",
        minimum=0.0,
        maximum=86400.0,
        used_when=_KALMAN,
    )


@dataclass(frozen=True)
class RegionsParameters:
    """Where in the picture objects are looked for."""

    file: str = parameter(
        "",
        "File of named polygons, YAML or JSON, in which objects are looked for or not, and what "
        "size and speed they must have there; see Regions. Empty: none.",
        names_file=True,
    )
    ignore: str = parameter(
        "",
        "Picture of the images' size or proportions; where it is white, objects are neither "
        "looked for nor reported. Empty: none.",
        names_file=True,
    )
    include: str = parameter(
        "",
        "Such a picture; objects are looked for only where it is white. Empty: everywhere.",
        names_file=True,
    )
    static_overlays: bool = parameter(
        True,
        "Find what stands still in the picture while the scene moves, and look for nothing there: "
        "clocks, text, cross-hairs, bars.",
        read_only=True,
    )


@dataclass(frozen=True)
class QosParameters:
    """How the node subscribes to its images."""

    reliability: str = parameter(
        "auto",
        "Reliability asked of the image's publishers; auto: reliable when every one offers it.",
        choices=("auto", "reliable", "best_effort"),
        read_only=True,
        node_only=True,
    )


@dataclass(frozen=True)
class DiagnosticsParameters:
    """What the node reports about itself."""

    min_rate: float = parameter(
        0.0,
        "Input rate below which the node warns; 0 takes any.",
        unit="Hz",
        minimum=0.0,
        maximum=1000.0,
        node_only=True,
    )
    max_turbulence: float = parameter(
        0.4,
        "Measured turbulence (rms tilt an axis) above which the node warns that objects may be "
        "missed, in per cent of the picture's width.",
        unit="%",
        minimum=0.0,
        maximum=100.0,
        node_only=True,
    )


@dataclass(frozen=True)
class Parameters:
    """All parameters, grouped as the stages of the method are."""

    image_transport: str = parameter(
        "raw",
        "Input topic: image_raw, or image_raw/compressed.",
        choices=("raw", "compressed"),
        read_only=True,
        node_only=True,
    )
    enabled: bool = parameter(
        True,
        "Whether the node listens from the start; else it stands by, at no cost, until ~/enable "
        "is called.",
        read_only=True,
        node_only=True,
    )
    idle_after: float = parameter(
        60.0,
        "How long nobody may listen to any result before the node stands by, at no cost, until "
        "somebody does; 0: it works for nobody, too.",
        unit="s",
        minimum=0.0,
        maximum=86400.0,
        node_only=True,
    )
    queue_size: int = parameter(
        10,
        "Images that may wait to be segmented; when more do, the oldest are dropped and counted.",
        unit="frames",
        minimum=1,
        maximum=1000,
        read_only=True,
        node_only=True,
    )
    threads: int = parameter(
        2,
        "Threads in which flow is computed, beside the one that draws outlines.",
        minimum=1,
        maximum=16,
        read_only=True,
        used_when=_DIS,
    )
    device: str = parameter(
        "auto",
        "Where RAFT runs; auto: on the GPU if there is one.",
        choices=("auto", "cpu", "cuda"),
        read_only=True,
        used_when=_RAFT,
    )
    max_objects: int = parameter(
        8,
        "Number of slots, each with a mask topic of its own, and most objects at a time.",
        minimum=1,
        maximum=64,
        read_only=True,
    )
    resolution: ResolutionParameters = field(default_factory=ResolutionParameters)
    latency: LatencyParameters = field(default_factory=LatencyParameters)
    flow: FlowParameters = field(default_factory=FlowParameters)
    motion: MotionParameters = field(default_factory=MotionParameters)
    seed: SeedParameters = field(default_factory=SeedParameters)
    growing: GrowingParameters = field(default_factory=GrowingParameters)
    outline: OutlineParameters = field(default_factory=OutlineParameters)
    refine: RefineParameters = field(default_factory=RefineParameters)
    tracking: TrackingParameters = field(default_factory=TrackingParameters)
    regions: RegionsParameters = field(default_factory=RegionsParameters)
    qos: QosParameters = field(default_factory=QosParameters)
    diagnostics: DiagnosticsParameters = field(default_factory=DiagnosticsParameters)

    @property
    def is_causal(self) -> bool:
        """Whether a frame is compared with earlier ones only."""
        return self.latency.mode == "causal"

    @property
    def looks_at_past(self) -> bool:
        """Whether what stands out from the scene's past is looked at; grown regions have none."""
        return self.seed.standing_out and self.outline.method != "none"

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> Parameters:
        """Build parameters from `{"flow.interval": 4, ...}`; what is not named has its default.

        :raises ParameterError: for a name that is not declared or a value that is refused.
        """
        return cls().replace(values)

    def replace(self, values: Mapping[str, object]) -> Parameters:
        """Return a copy with the named values changed, all of them or, on an error, none.

        A parameter that is gone is left out, and warned about once.

        :raises ParameterError: for a name that is not declared or a value that is refused.
        """
        known = {declaration.name: declaration for declaration in declarations()}
        changed = self
        for given, value in values.items():
            name = present_name(given)
            if is_gone(name):
                _warn_once(
                    name,
                    f"parameter {name} is gone, and has no effect: {_REPLACED[name]} "
                    "has taken its place; with the next minor version it is refused",
                )
                continue
            if name not in known:
                raise UnknownParameterError(f"unknown parameter {name}{_suggestion(name, known)}")
            changed = _with_value(changed, name.split("."), known[name].check(value))
        return changed

    def idle(self, *, replayed: bool = False) -> dict[str, str]:
        """Return the parameters that have no effect as the others stand.

        Each comes with a line for people: why, and with what it is used.

        :param replayed: whether a bag is replayed; what only the live node reads is idle then.
        """
        values = self.as_mapping()
        choices = {declared.name: declared.choices for declared in declarations()}
        lines = {}
        for declared in declarations():
            name = declared.name
            unmet = {
                other: wanted
                for other, wanted in declared.used_when.items()
                # What a class of the user's own makes of the parameter isn't known.
                if values[other] not in wanted and values[other] in choices[other]
            }
            if unmet:
                state = " and ".join(f"{other} is {values[other]}" for other in unmet)
                use = _together(unmet)
                lines[name] = f"{name} has no effect while {state}; it is used with {use}"
            elif replayed and declared.node_only and values[name] not in declared.replayed_values:
                also = declared.replayed_values
                but = f", and at {_either(also)}" if also else ""
                lines[name] = f"{name} has no effect here; it is used by the live node{but}"
        return lines

    def idle_changes(self, before: Parameters) -> list[str]:
        """Return a line for each parameter that differs from `before` and has no effect."""
        earlier, now = before.as_mapping(), self.as_mapping()
        return [line for name, line in self.idle().items() if now[name] != earlier[name]]

    def as_mapping(self) -> dict[str, Value]:
        """Every parameter's value under its dotted name, in the order of declaration."""
        return {name: value for name, _, value in _walk(self)}


@functools.cache
def declarations() -> tuple[Declaration, ...]:
    """Return every parameter's declaration, in order."""
    return tuple(
        Declaration(name=name, default=value, **declared.metadata)
        for name, declared, value in _walk(Parameters())
    )


def present_name(name: str) -> str:
    """Return what a parameter is called now; a name that it had before is warned about, once."""
    for declared in declarations():
        if name in declared.former_names:
            _warn_once(
                name,
                f"parameter {name} is called {declared.name} now; the old name goes with the next "
                "minor version",
            )
            return declared.name
    return name


def is_gone(name: str) -> bool:
    """Whether a parameter was there in the minor version before, and another does its work now."""
    return name in _REPLACED


def _warn_once(name: str, line: str) -> None:
    if name not in _warned_of:
        _warned_of.add(name)
        _LOGGER.warning("%s", line)


def belongs_to_middleware(name: str) -> bool:
    """Whether `name` is one that every ROS node has, as `use_sim_time`."""
    return name.split(".")[0] in _MIDDLEWARE_NAMES


def markdown_table() -> str:
    """Return the table of parameters in docs/parameters.md."""
    rows = ["| parameter | default | range | what it is |", "| --- | --- | --- | --- |"]
    for declared in declarations():
        if declared.choices:
            limits = ", ".join(declared.choices) + ", or a class" * declared.extensible
        elif declared.minimum is not None and declared.maximum is not None:
            limits = f"{declared.minimum:g} to {declared.maximum:g}"
        else:
            limits = ""
        unit = f" {declared.unit}" if declared.unit else ""
        words = (declared.description, declared.condition, "" if declared.read_only else "*")
        description = " ".join(filter(None, words))
        rows.append(f"| `{declared.name}` | {declared.default}{unit} | {limits} | {description} |")
    return "\n".join(rows)


def _walk(group: Any, prefix: str = "") -> Iterator[tuple[str, dataclasses.Field[Any], Value]]:
    for declared in dataclasses.fields(group):
        value = getattr(group, declared.name)
        if dataclasses.is_dataclass(value):
            yield from _walk(value, f"{prefix}{declared.name}.")
        else:
            yield f"{prefix}{declared.name}", declared, value


def _with_value(group: Any, path: list[str], value: Value) -> Any:
    if len(path) > 1:
        value = _with_value(getattr(group, path[0]), path[1:], value)
    return dataclasses.replace(group, **{path[0]: value})


def _suggestion(name: str, known: Mapping[str, Declaration]) -> str:
    # Who mistypes a former name is told the present one.
    present = {former: d.name for d in known.values() for former in d.former_names}
    near = difflib.get_close_matches(name, [*known, *present], n=1)
    return f"; did you mean {present.get(near[0], near[0])}?" if near else ""


def _either(values: tuple[Value, ...]) -> str:
    return " or ".join(str(value) for value in values)


def _together(wanted: UsedWhen) -> str:
    return " and ".join(f"{name} {_either(values)}" for name, values in wanted.items())


def _article(kind: type[Value]) -> str:
    names = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}
    return names[kind]
