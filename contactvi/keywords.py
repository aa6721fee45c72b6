"""Arguments by keyword: checked by name, shown in signatures where they are passed on, and what users call them.

A function that passes options on (`**options`) shows them in its signature and in its docstring: their types, defaults
and texts stand in one place, the function or the options that they are passed to.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import re
import types
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar, get_type_hints

from contactvi.errors import InputError, did_you_mean, nearest

Function = TypeVar("Function", bound=Callable[..., Any])
Class = TypeVar("Class", bound=type)

# What other programs and textbooks call it -> what it is called here.
_SYNONYMS = {
    "dt": "timestep time_step step h delta_t step_size stepsize max_step",
    "duration": "T t_end tend t_final tf t_max tmax time end_time horizon t_span",
    "tol": "tolerance accuracy atol rtol eps precision",
    "friction": "mu friction_coefficient coefficient_of_friction mu_s mu_d mu_k",
    "restitution": "e cor coefficient_of_restitution bounce bounciness elasticity",
    "gravity": "g grav",
    "q0": "x0 q q_0 qpos y0 start",
    "v0": "v v_0 qvel dq0 qd0 qdot0 velocity0",
    "control": "tau u torque torques inputs controls",
    "radius": "r",
    "mass": "m",
    "size": "dims dimensions extents sizes lengths",
    "placement": "pos position xyz pose location origin",
    "color": "colour rgba rgb",
    "stiffness": "k spring_constant",
    "damping": "c d damper",
    "normal": "n",
    "impact": "impact_map",
    "overwrite": "force exist_ok",
    "fps": "framerate frame_rate rate",
}
_MEANT = {word: name for name, words in _SYNONYMS.items() for word in words.split()}
_ELSEWHERE = {  # what has another place
    "friction": "Contacts have it: scene.set_contact(friction=...)",
    "restitution": "Contacts have it: scene.set_contact(restitution=...)",
    "gravity": "The scene has it: Scene(gravity=(0, 0, -9.81))",
    "mass": "Bodies have it: scene.add_sphere(..., mass=...)",
    "stiffness": "Joints have it: scene.set_joint(joint, stiffness=...)",
    "damping": "Joints have it: scene.set_joint(joint, damping=...)",
}
_TOLD = {  # (what others call it, a known name) -> what is said of it
    ("half_extents", "size"): "Did you mean 'size', the full edges: twice as long?",
    ("half_size", "size"): "Did you mean 'size', the full edges: twice as long?",
    ("halfsize", "size"): "Did you mean 'size', the full edges: twice as long?",
    **{
        (word, "order"): "Integrators differ by order=2, 4, ... 16, impact maps by impact='ctec', 'dtec' or 'mhc'"
        for word in ("method", "integrator", "scheme", "solver")
    },
}
# Names of other programs -> the name of an attribute here.
_ATTRIBUTES = {
    "add_halfspace": "add_plane add_ground add_floor add_ground_plane plane ground",
    "add_box": "add_cube add_cuboid add_block",
    "add_sphere": "add_ball",
    "from_mjcf": "from_xml from_xml_path load_mjcf",
    "add_urdf": "load_urdf from_urdf load_model",
    "simulate": "run rollout integrate",
    "Simulator": "Simulation Sim",
    "Scene": "World Model System",
}
_NAMED = {word: name for name, words in _ATTRIBUTES.items() for word in words.split()}
_COUNTS = ("steps", "n_steps", "num_steps", "nsteps", "N")


def synonym(name: str) -> str:
    """Return what is called so elsewhere by its name here, else the name itself."""
    return _MEANT.get(name, name)


def meant(name: str, known: Iterable[str]) -> str:
    """Return the remedy for an unknown name: what others call a known one, where it belongs, or the nearest one."""
    names = list(known)
    for choice in names:
        if (name, choice) in _TOLD:
            return _TOLD[name, choice]
    word = _MEANT.get(name, name)
    for choice in (word, f"{word}s"):
        if choice in names and choice != name:
            return f"Did you mean {choice!r}?"
    if name in _COUNTS and "duration" in names:
        return "Give duration=..., the number of steps times dt"
    return _ELSEWHERE[word] if word in _ELSEWHERE else did_you_mean(name, names)


def no_attribute(owner: str, name: str, known: Iterable[str]) -> str:
    """Return the text of the AttributeError for a name that a module or an object has not, with the nearest one."""
    names = [choice for choice in known if not choice.startswith("_")]
    near = _NAMED.get(name)
    near = near if near in names else nearest(name, names, cutoff=0.6)
    return f"{owner} has no attribute {name!r}." + ("" if near is None else f" Did you mean {near!r}?")


def check_keywords(function: Callable[..., Any], given: Iterable[str], caller: str, skip: Iterable[str] = ()) -> None:
    """Raise InputError for a name by which a function takes nothing, with those by which it does.

    Args:
        function: its first argument is what it is about, and has no name for the caller.
        caller: what was called. skip: names that it has not.
    """
    _, *parameters = inspect.signature(function).parameters.values()
    known = [p.name for p in parameters if p.kind is not p.VAR_KEYWORD and p.name not in skip]
    for name in given:
        if name not in known:
            raise InputError(
                f"{caller} has no option {name!r}", name=name, expected=f"some of {', '.join(known)}", got=name,
                remedy=meant(name, known),
            )  # fmt: skip


def refusing(function: Function) -> Function:
    """Let a function refuse unknown and missing arguments with an InputError that names what may have been meant."""
    whole = list(inspect.signature(function).parameters.values())
    parameters = [p for p in whole if p.name != "self"]
    known, needed = {p.name for p in parameters}, {p.name for p in parameters if p.default is p.empty}
    needed -= {p.name for p in parameters if p.kind is p.VAR_POSITIONAL}
    if not known or any(p.kind is p.VAR_KEYWORD for p in parameters):
        return function

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        if not named.keys() <= known:
            name = next(name for name in named if name not in known)
            raise InputError(
                f"{function.__name__} has no argument {name!r}", name=name,
                expected=f"some of {', '.join(p.name for p in parameters)}", got=name,
                remedy=meant(name, [p.name for p in parameters]),
            )  # fmt: skip
        missing = needed - named.keys() - {p.name for p in whole[: len(arguments)]} if needed else None
        if missing:
            lacking = [p.name for p in parameters if p.name in missing]
            raise InputError(
                f"{function.__name__} lacks " + " and ".join(map(repr, lacking)), name=lacking[0],
                expected=", ".join(p.name for p in parameters if p.name in needed),
                got=", ".join(p.name for p in parameters if p.name in needed - missing) or "none of them",
                remedy="Give " + ", ".join(f"{name}=..." for name in lacking),
            )  # fmt: skip
        return function(*arguments, **named)

    return call  # type: ignore[return-value]


def refusing_methods(cls: Class) -> Class:
    """Let all public methods of a class refuse unknown and missing arguments."""
    for name, function in list(vars(cls).items()):
        if not name.startswith("_") and inspect.isfunction(function):
            setattr(cls, name, refusing(function))
    return cls


def with_keywords(*sources: Any, skip: Iterable[str] = ()) -> Callable[[Function], Function]:
    """Let the signature of a function with **options show these: keywords of functions, or entries of a TypedDict.

    In the place of the entry **options of its docstring stand the texts of the options, from the docstrings of the
    sources, or of what their attribute `described` names.

    Args:
        skip: names of the sources that the function does not take.
    """

    def decorate(function: Function) -> Function:
        own = inspect.signature(function)
        kept = [p for p in own.parameters.values() if p.kind is not p.VAR_KEYWORD]
        names = {*(p.name for p in kept), *skip}
        added: dict[str, inspect.Parameter] = {}
        for source in sources:
            for parameter in keywords_of(source):
                if parameter.name not in names:
                    added.setdefault(parameter.name, parameter)
        function.__signature__ = own.replace(parameters=[*kept, *added.values()])  # type: ignore[attr-defined]
        texts: dict[str, str] = {}
        for source in sources:
            texts = {**_entries(getattr(source, "described", source).__doc__ or ""), **texts}
        _describe(function, [texts[name] for name in added if name in texts])
        return function

    return decorate


class Passed:
    """A method that is a function of another module, to which it passes the object: loaded when it is asked for.

    Its arguments, their texts and types are those of the function.
    """

    def __init__(self, module: str, function: str) -> None:
        self._module, self._function, self._name = module, function, function
        self._made: Callable[..., Any] | None = None

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: object, owner: type | None = None) -> Any:
        if self._made is None:
            self._made = self._method(getattr(importlib.import_module(self._module), self._function))
        return self._made if instance is None else types.MethodType(self._made, instance)

    def _method(self, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def method(self: Any, *arguments: Any, **options: Any) -> Any:
            check_keywords(function, options, name)
            return function(self, *arguments, **options)

        name = method.__name__ = self._name
        first, *others = inspect.signature(function).parameters.values()
        whole = [inspect.Parameter("self", first.kind), *others]
        method.__signature__ = inspect.signature(function).replace(parameters=whole)  # type: ignore[attr-defined]
        return method


def keywords_of(source: Any) -> list[inspect.Parameter]:
    """Return the keyword-only parameters of a function, or those that the entries of a TypedDict stand for."""
    if isinstance(source, type) and issubclass(source, dict):
        return [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kind)
            for name, kind in get_type_hints(source).items()
        ]
    parameters: Mapping[str, inspect.Parameter] = inspect.signature(source).parameters
    return [p for p in parameters.values() if p.kind is p.KEYWORD_ONLY]


_ENTRY = re.compile(r"^( {4,12})(\w+(?:, \w+)*): ", re.MULTILINE)


def _entries(doc: str) -> dict[str, str]:
    """Return the texts of the arguments of a docstring, by name, without indentation before the name."""
    _, _, arguments = inspect.cleandoc(doc).partition("Args:\n")
    block = re.split(r"\n\n", arguments, maxsplit=1)[0]
    found: dict[str, str] = {}
    for text in re.split(r"\n(?= {4}\S)", "\n" + block):
        head = _ENTRY.match(text.strip("\n"))
        if head is not None:
            for name in head[2].split(", "):
                first, *others = text.strip("\n").splitlines()
                found[name] = "\n".join([first.strip(), *(line[4:] for line in others)])
    return found


def _describe(function: Any, texts: list[str]) -> None:
    """Put the texts of options in the place of the entry **options of a docstring."""
    doc = inspect.cleandoc(function.__doc__ or "")
    place = re.search(r"^    \*\*options:.*?(?=\n    \S|\n\n|\Z)", doc, re.MULTILINE | re.DOTALL)
    if place is None:
        return
    lines = [f"    {line}" for text in dict.fromkeys(texts) for line in text.splitlines()]
    function.__doc__ = doc[: place.start()] + "\n".join(lines) + doc[place.end() :]
