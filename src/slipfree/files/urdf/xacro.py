"""Xacro: expansion of trusted files in a process of its own, and values in files not expanded."""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca

from slipfree.core.errors import DataError, ModelError, missing_package, shortened
from slipfree.files.urdf.tree import Findings
from slipfree.files.urdf.xml import Element
from slipfree.system.processes import ProcessDiedError, bounded_call
from slipfree.system.regular_files import regular_file, resolve_links
from slipfree.vehicle.formula import evaluate, names_in

FINDER = "ament_index_python"  # package of ROS that xacro asks for the folders of packages
MAX_SECONDS = 6.0  # largest duration of an expansion [s]
MAX_BYTES = 20_000_000  # size of the largest accepted URDF
MAX_REPLACED = 20_000  # expressions that are replaced in a file that is not expanded
PREFIX = "xacro:"
NAMESPACE = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
# tags without links or joints
IGNORED = ("gazebo", "material", "xacro:property", "xacro:arg", "xacro:macro")
# further elements of robots in URDF files and in extensions of it
KNOWN = {
    *("link", "joint", "transmission", "ros2_control", "sensor", "mujoco", "loop_joint"),
    *IGNORED,
}
ELEMENTS = ("macro", "property", "arg", "include", "if", "unless")  # of xacro, in robots
PARTS = {  # elements in links and joints
    *("inertial", "visual", "collision", "geometry", "origin", "mass", "inertia", "axis", "limit"),
    *("parent", "child", "mimic", "dynamics", "calibration", "safety_controller", "box"),
    *("cylinder", "sphere", "mesh", "color", "texture"),
}
PACKAGE = re.compile(r"^(?:file://)?\$\(find\s+([\w-]+)\)")
COMMAND = re.compile(r"(?<!\$)\$\(([^()$]*)\)")
EXPRESSION = re.compile(r"(?<!\$)\$\{([^{}$]*)\}")


def package_folders(package: str, folder: Path) -> Iterator[Path]:
    """Yield the possible folders of a ROS package to which a file in ``folder`` refers."""
    for above in (folder.resolve(), *folder.resolve().parents):
        manifest = above / "package.xml"
        is_named = manifest.is_file() and f"<name>{package}</name>" in manifest.read_text("latin-1")
        if is_named or above.name == package:
            yield above
        yield above / package
    for variable, inside in (("AMENT_PREFIX_PATH", "share"), ("ROS_PACKAGE_PATH", "")):
        for root in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield Path(root) / inside / package


def trusted_paths(files: Iterable[str | os.PathLike[str]]) -> frozenset[str]:
    """Return the resolved paths of xacro files that the user trusts; they must be regular files."""
    for file in files:
        with regular_file(Path(file), "a xacro file to trust"):
            pass
    return frozenset(str(resolve_links(Path(file).absolute())) for file in files)


def is_trusted(path: Path, trusted: frozenset[str]) -> bool:
    """Return whether a file is one of those that `trusted_paths` returned."""
    return str(resolve_links(path.absolute())) in trusted


def ways(file: str) -> str:
    """Return the two ways to use a xacro file, for messages."""
    name = shlex.quote(file)
    return (
        "xacro is a program, which runs only if you trust it: expand it yourself with xacro "
        f"{name} > robot.urdf, or add --trust {name} to the command (Python: trust=...)"
    )


def expanded(path: Path, arguments: Mapping[str, str]) -> tuple[bytes, frozenset[str]]:
    """Return the URDF that a xacro file describes, and the names of all macros in the files.

    The caller checks that the user trusts it.

    The expansion may take 6 s, 2 GB of memory, and 20 MB for the URDF; its output is discarded.
    """
    with regular_file(path, "xacro"):
        pass
    if find_spec("xacro") is None:
        hint = f"; or expand the file elsewhere: xacro {shlex.quote(str(path))} > robot.urdf"
        raise DataError(f"{path}: {missing_package('xacro', 'urdf')}{hint}")
    try:
        return bounded_call(_expand, path, dict(arguments), seconds=MAX_SECONDS)
    except ProcessDiedError as error:
        raise DataError(
            f"{path}: expected xacro that can be expanded in {MAX_SECONDS:g} s, found that "
            f"{error}; correct macros that call themselves, large powers and endless loops"
        ) from error


def _expand(path: Path, arguments: Mapping[str, str]) -> tuple[bytes, frozenset[str]]:
    """Expand a xacro file in this process; parameters and errors are those of `expanded`."""
    import xacro

    if find_spec(FINDER) is None:
        # xacro asks this package of ROS for folders
        def folder_of(package: str) -> str:
            """Return the folder of a ROS package."""
            for folder in package_folders(package, path.parent):
                if folder.is_dir():
                    return str(folder)
            raise DataError(
                f"{path}: expected the package {package!r} in a folder above this file or in "
                "ROS_PACKAGE_PATH, found none; put it there, or add its parent folder to "
                "ROS_PACKAGE_PATH"
            )

        finder, packages = ModuleType(FINDER), ModuleType(f"{FINDER}.packages")
        packages.__dict__["get_package_share_directory"] = folder_of
        sys.modules.update({FINDER: finder, f"{FINDER}.packages": packages})
    macros: set[str] = set()
    parse, grab = xacro.parse, xacro.grab_macro

    def parse_regular(document: Any, filename: str | None = None) -> Any:
        if filename is not None:  # not a pipe, whose reading may never end
            with regular_file(Path(filename), "xacro"):
                pass
        return parse(document, filename)

    def record(element: Any, known: Any) -> None:
        macros.add(element.getAttribute("name").removeprefix("xacro:"))
        grab(element, known)

    xacro.parse, xacro.grab_macro = parse_regular, record
    try:
        document: Any = xacro.process_file(str(path), mappings=dict(arguments), verbosity=0)
        data: bytes = document.toprettyxml(indent="  ").encode()
    except Exception as error:  # xacro raises errors of many kinds
        cause = getattr(error, "exc", None) or error
        if isinstance(cause, DataError | MemoryError):
            raise cause from None
        message = " ".join(str(error).split())[:500] or type(error).__name__
        if (inside := xacro.filestack[-1:]) not in ([], [str(path)]):
            message += f" (in {inside[0]})"
        remedy = (
            f"add {NAMESPACE} to <robot>"
            if message.startswith("unbound prefix")
            else "correct it, or give its arguments in a vehicle file, as in "
            'arguments = { name = "value" }'
        )
        raise DataError(
            f"{path}: expected xacro that can be expanded, found: {message}; {remedy}"
        ) from None
    if len(data) > MAX_BYTES:
        raise DataError(
            f"{path}: expected xacro that expands to at most {MAX_BYTES / 1e6:g} MB, found "
            f"{len(data) / 1e6:.3g} MB; correct macros that multiply"
        )
    return data, frozenset(macros)


class _Values:
    """Values of the properties and arguments of a robot, and variables of the environment.

    Properties may multiply: a few lines describe more text than the memory holds. The number of
    replacements and the length of their results are therefore limited, for the whole file.
    """

    def __init__(self, file: str, arguments: Mapping[str, str]) -> None:
        self.file, self.line = file, 0  # line of the element in which texts are replaced
        self.arguments = dict(arguments)
        self.given = frozenset(arguments)
        self.properties: dict[str, str] = {}
        self.variables: dict[str, str] = {}
        self._count = self._length = 0

    def text(self, text: str) -> str:
        """Return a text with the expressions replaced that have a value."""
        if "$" not in text:
            return text
        text = PACKAGE.sub(r"package://\1", text)
        text = COMMAND.sub(self._limited(self._command), text)
        return EXPRESSION.sub(self._limited(self._expression), text)

    def define(self, element: Element) -> None:
        """Add a property or an argument; a property with several values has none."""
        self.line = element.line
        name, default = element.attributes.get("name", ""), element.attributes.get("default")
        if element.tag == "xacro:arg" and default is not None and name not in self.given:
            self.arguments[name] = self.text(default)
        if element.tag == "xacro:property":
            value = self.text(element.attributes.get("value", "${}"))
            same = self.properties.setdefault(name, value) == value
            self.properties[name] = value if same else "${}"

    def _limited(self, value: Callable[[re.Match[str]], str]) -> Callable[[re.Match[str]], str]:
        """Return a function of a match that raises DataError beyond the limits of the file."""

        def limited(match: re.Match[str]) -> str:
            """Return the value of a match, and count it."""
            text = value(match)
            self._count, self._length = self._count + 1, self._length + len(text)
            if self._count > MAX_REPLACED or self._length > MAX_BYTES:
                raise DataError(
                    f"{self.file}:{self.line}: expected at most {MAX_REPLACED} expressions, whose "
                    f"values have at most {MAX_BYTES / 1e6:g} million characters, found more; "
                    "correct properties that multiply, or expand the file with xacro"
                )
            return text

        return limited

    def _command(self, match: re.Match[str]) -> str:
        """Return the value of ``$(arg NAME)``, ``$(optenv NAME DEFAULT)`` or ``$(dirname)``.

        Other commands stay. The environment is not read, so that a file has one meaning.
        """
        name, *words = match[1].split() or [""]
        if name == "optenv" and words:
            self.variables[words[0]] = default = " ".join(words[1:])
            return default
        if name == "arg" and len(words) == 1:
            return self.arguments.get(words[0], match[0])
        return "." if name == "dirname" and not words else match[0]

    def _expression(self, match: re.Match[str]) -> str:
        """Return the value of ``${...}``, or the text as it is if a property is unknown.

        As in Python, whole numbers without ``/``, a point or an exponent stay integers.
        """
        text = match[1].strip().replace("math.pi", "pi")
        if text in self.properties and "$" not in self.properties[text]:
            return self.properties[text]
        try:
            values = {name: ca.SX(float(self.properties[name])) for name in names_in(text)}
            number = float(ca.evalf(evaluate(text, values)))
        except (ModelError, KeyError, ValueError):
            return match[0]
        if not all(each.is_regular() for each in (ca.SX(number), *values.values())):
            return match[0]
        is_whole = number.is_integer() and not re.search(r"[./e]", text)
        # a double represents integers below 1e15 exactly
        return str(int(number)) if is_whole and abs(number) < 1e15 else repr(number)


def substitute(robot: Element, file: str, arguments: Mapping[str, str]) -> tuple[str, ...]:
    """Replace simple expressions of xacro in a robot by their values; return notes on them.

    ``$(arg NAME)`` takes the value of ``arguments`` or the default in the file; ``$(optenv NAME
    DEFAULT)`` takes its default, since variables of the environment are not read; ``$(find NAME)``
    at the beginning becomes ``package://NAME``; ``${...}`` is replaced if it is a property, or a
    formula (`slipfree.vehicle.formula`) of properties that are numbers. Nothing is executed.
    DataError is raised for more than `MAX_REPLACED` expressions, or `MAX_BYTES` of their values.
    """
    values = _Values(file, arguments)
    for part in robot.children:
        values.define(part)
        if part.tag.startswith(PREFIX):
            continue
        for element in part.everything():
            values.line = element.line
            for key, text in element.attributes.items():
                element.attributes[key] = values.text(text)
    pairs = ", ".join(f"{name} = {value!r}" for name, value in values.variables.items())
    words = "variables of the environment are not read, $(optenv ...) takes its default"
    return (f"{words}: {pairs}",) if pairs else ()


def check_macro_calls(robot: Element, file: str, macros: frozenset[str] = frozenset()) -> None:
    """Raise VehicleError for calls of macros and elements of xacro without the prefix ``xacro:``.

    Elements of xacro are recognised in files in which others have the prefix.
    """
    findings, parts = Findings(file), [*robot.everything()]
    own = {part.attributes.get("name", "") for part in parts if part.tag == "xacro:macro"}
    called = (own | macros) - KNOWN - PARTS
    for part in parts:
        if part.tag in called:
            findings.add(
                part.line,
                "expected calls of macros with the prefix 'xacro:', found the call "
                f"<{part.tag}> of the macro {part.tag!r}; write <{PREFIX}{part.tag} ...>",
            )
    if any(part.tag.startswith(PREFIX) for part in parts):
        for part in robot.children:
            if part.tag in ELEMENTS:
                found = f"found <{part.tag}>; write <{PREFIX}{part.tag} ...>"
                findings.add(part.line, f"expected elements of xacro with the prefix, {found}")
    if findings.errors:
        findings.stop()


def unknown_elements(robot: Element) -> tuple[str, ...]:
    """Return messages on elements that are not known in URDF, such as calls of macros."""
    return tuple(
        f"{each.line}: <{each.tag}> is not an element of URDF; a macro of xacro is called with the "
        f"prefix 'xacro:', as in <{PREFIX}{each.tag} ...>, and the file is then expanded"
        for each in robot.children
        if each.tag not in KNOWN and ":" not in each.tag
    )


def without_xacro(robot: Element, file: str, findings: Findings) -> tuple[Element, tuple[str, ...]]:
    """Return a robot without its links that have unexpanded xacro, and the names of these links.

    VehicleError is raised if the xacro may belong to the drive train: it is not in a link or a
    joint, or a continuous joint is at or below it.
    """
    parts = [part for part in robot.children if part.tag not in IGNORED]
    raw = [part for part in parts if any(map(_xacro_in, part.everything()))]
    joints = [part for part in parts if part.tag == "joint"]
    left_out = {_link_of(part) for part in raw}
    below: dict[str, list[str]] = {}
    for joint in joints:
        below.setdefault(link_at(joint, "parent"), []).append(_link_of(joint))
    reached = [*left_out]
    for link in reached:  # the list grows
        reached += below.pop(link, ())
    left_out |= {*reached}
    dropped = [each for each in joints if _link_of(each) in left_out]
    turning = any(each.attributes.get("type") == "continuous" for each in dropped)
    if raw and (turning or "" in left_out or len(dropped) < len(left_out)):
        element = next(each for part in raw for each in part.everything() if _xacro_in(each))
        findings.add(
            element.line,
            f"expected plain URDF, found xacro, {_xacro_in(element)}, which may belong to the "
            f"drive train; {ways(file)}",
        )
        every = [*robot.everything()]
        has_prefix = any(each.tag.startswith(PREFIX) for each in every)
        if has_prefix and not any("xmlns:xacro" in each.attributes for each in every):
            findings.add(
                robot.line,
                "expected a declaration of the prefix 'xacro' in <robot>, found none; write "
                f"<robot {NAMESPACE} ...>",
            )
        findings.stop()
    kept = [part for part in parts if _link_of(part) not in left_out]
    return replace(robot, children=kept), tuple(sorted(left_out))


def _xacro_in(element: Element) -> str:
    """Return the description of xacro in an element: its tag or an attribute; empty without any."""
    if element.tag.startswith(PREFIX):
        return f"<{element.tag}>"
    for key, text in element.attributes.items():
        if "${" in text or "$(" in text:
            return f"{shortened(text, 60)!r} in the attribute {key!r} of <{element.tag}>"
    return ""


def _link_of(part: Element) -> str:
    if part.tag == "joint":
        return link_at(part, "child")
    return part.attributes.get("name", "") if part.tag == "link" else ""


def link_at(joint: Element, tag: str) -> str:
    """Return the name of the parent or child link of a joint; empty without one."""
    end = joint.first(tag)
    return "" if end is None else end.attributes.get("link", "")
