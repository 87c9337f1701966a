"""Reads a whole scene file (MJCF) with all that it includes: shelf, robot and meshes.

Left to itself, MuJoCo opens whatever file a text names, anywhere on the computer. So the files are
read here, and only those in the scene's folder. MuJoCo gets one text, written anew from the
elements that are listed below, and the meshes' bytes. What is only seen (textures, materials,
lights, cameras) is left out.
"""

# MuJoCo's compiled modules come without type stubs.
# pyright: reportAttributeAccessIssue=false

import dataclasses
import functools
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import MIB, read_file, sha256
from pgf_jax.physics.hand import EE_POINT, EE_POINT_AHEAD
from pgf_jax.settings import check_path

BASE = ("robot_lin_x", "robot_lin_y", "robot_ang_z")
SITES = ("ee_point_1", "ee_point_2")  # the end-effector point, and one ahead of it
# Angles of the finger joints of the closed gripper, rad.
FINGERS = {
    "joint7_1": 0.822592,
    "joint8_1": -0.186819,
    "joint9_1": -0.642,
    "joint10_1": 0.721295,
    "joint7_2": 0.822595,
    "joint8_2": -0.18689,
    "joint9_2": -0.642,
    "joint10_2": 0.721342,
}

# Elements that are handed on, and those that are left out; with any other a file is refused.
_HELD = frozenset(("mujoco", "compiler", "option", "flag", "size", "statistic", "default"))
_HELD |= {"asset", "mesh", "worldbody", "body", "geom", "joint", "freejoint", "inertial", "site"}
_HELD |= {"contact", "exclude", "pair"}
_SEEN = frozenset(("texture", "material", "light", "camera", "visual", "custom", "keyframe"))
_TEXT, _MESH = "a scene file (MJCF) with what it includes", "a mesh of a scene"
_MOST_TEXT, _MOST_MESHES = 4 * MIB, 64 * MIB  # of a scene; the published ones take 30 kB and 3 MB
_MOST_ARENA = 512 * MIB  # of a state; that of the published scenes is 27 MiB
_NEAR_M = 1e-3  # of the end effector to the planner's


@dataclasses.dataclass(frozen=True)
class SceneModel:
    """All that a world needs of a scene file and its folder; equal where the content is.

    It holds the sources, and not the compiled model: that takes 10 MB, and most of the sources are
    meshes, which models share.

    Attributes:
      digest: SHA-256 of the content, in hex.
      n_objects: N.
      text: MJCF without includes.
      meshes: pairs of file name and content.
    """

    digest: str
    n_objects: int
    text: str = dataclasses.field(repr=False, compare=False)
    meshes: tuple[tuple[str, bytes], ...] = dataclasses.field(repr=False, compare=False)

    def compile(self) -> Any:
        """Compile it to an `MjModel`.

        Raises:
          ValueError, mujoco.FatalError: MuJoCo refuses it; `read_scene_model` has tried that.
        """
        return mujoco.MjModel.from_xml_string(self.text, dict(self.meshes))


def read_scene_model(path: str | Path) -> SceneModel:
    """Read a scene file with its shelf and robot.

    Args:
      path: an MJCF file in the published scenes' form, beside the folders that it includes.

    Raises:
      BadInput: one line that names the file: it or a file that it names is missing, too large,
        malformed or outside its folder; it holds what is not supported, or MuJoCo refuses it; or
        the bodies, joints and sites are not those by which the robot is driven.
    """
    path = check_path("path", path)
    files = _Files(path)
    try:
        root = files.read()
        text = ET.tostring(root, encoding="unicode")
    except RecursionError:
        raise BadInput(f"{path}: nested too deeply, expected {_TEXT}") from None
    meshes = tuple(sorted(files.meshes.items()))
    # The names of the meshes are digests of their content.
    n_objects = sum(body.get("name", "").startswith("object_") for body in root.iter("body"))
    model = SceneModel(sha256(text.encode()), n_objects, text, meshes)
    try:
        _check(model.compile(), n_objects)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None
    except (ValueError, mujoco.FatalError) as error:
        raise BadInput(f"{path}: MuJoCo refuses it ({error}), expected {_TEXT}") from None
    return model


# -- files ---------------------------------------------------------------------------------------


class _Files:
    """The files of one scene, and what was read of them so far."""

    def __init__(self, path: Path) -> None:
        self.path, self.folder = path, path.absolute().parent.resolve()
        self.meshes: dict[str, bytes] = {}
        self._text_bytes, self._mesh_bytes = 0, 0
        self._included: set[Path] = set()

    def read(self) -> ET.Element:
        """The scene's root element, without includes and with the meshes' new names."""
        root = self._parsed(self.path, str(self.path))
        if root.tag != "mujoco":
            raise BadInput(f"{self.path}: root element is <{root.tag}>; expected <mujoco>")
        root = self._expanded(root)
        folders = {"mesh": "", "texture": ""}
        for compiler in root.iterfind("compiler"):
            for kind in folders:
                for attribute in ("assetdir", f"{kind}dir"):
                    folders[kind] = compiler.get(attribute, folders[kind])
            for attribute in ("assetdir", "meshdir", "texturedir"):
                compiler.attrib.pop(attribute, None)
        for element in root.iter():
            for attribute, value in element.items():
                if attribute.startswith("file"):
                    name = str(Path(folders.get(element.tag, ""), value))
                    self._inside(name)
                    if element.tag == "mesh":
                        self._take(element, name)
        self._prune(root)
        return root

    def _parsed(self, path: Path, name: str) -> ET.Element:
        try:
            content = read_file(path, _TEXT, _MOST_TEXT)
        except BadInput as error:
            # Of a file that is included the scene file has to be named, too.
            raise error if path == self.path else BadInput(f"{self.path}: {error}") from None
        self._text_bytes += len(content)
        if self._text_bytes > _MOST_TEXT:
            raise self._too_large(_TEXT, _MOST_TEXT)
        try:
            return ET.fromstring(content)
        # The parser also lets errors of the text decoding through.
        except (ET.ParseError, ValueError, LookupError) as error:
            where = "" if path == self.path else f"{name}: "
            raise BadInput(
                f"{self.path}: {where}not well-formed XML ({error}); expected {_TEXT}"
            ) from None

    def _expanded(self, element: ET.Element) -> ET.Element:
        """A copy without text, in which each include is replaced by what the file holds."""
        copy = ET.Element(element.tag, element.attrib)
        for child in element:
            if child.tag == "include":
                copy.extend(self._include(child))
            else:
                copy.append(self._expanded(child))
        return copy

    def _include(self, element: ET.Element) -> Iterator[ET.Element]:
        if list(element.attrib) != ["file"] or len(element):
            raise BadInput(
                f"{self.path}: include has {short_repr(element.attrib)}; expected a file alone"
            )
        name = element.attrib["file"]
        path = self._inside(name)
        if path in self._included:  # MuJoCo refuses this, too
            raise BadInput(f"{self.path}: {name!r} is included twice; expected it once")
        self._included.add(path)
        return iter(self._expanded(self._parsed(path, name)))

    def _take(self, element: ET.Element, name: str) -> None:
        """Read a mesh, and name its file by its content."""
        try:
            content = read_file(self._inside(name), _MESH, _MOST_MESHES)
        except BadInput as error:
            raise BadInput(f"{self.path}: {error}") from None
        # MuJoCo names a mesh by its file, and knows its format by the file's suffix.
        element.attrib.setdefault("name", Path(name).stem)
        new = sha256(content) + Path(name).suffix
        element.set("file", new)
        self._mesh_bytes += 0 if new in self.meshes else len(content)
        if self._mesh_bytes > _MOST_MESHES:
            raise self._too_large("meshes of a scene", _MOST_MESHES)
        self.meshes[new] = _shared(content)

    def _inside(self, name: str) -> Path:
        """The path of a file in the scene's folder."""
        try:
            path = (self.folder / name).resolve()
        except (OSError, ValueError, RuntimeError) as error:  # of links in a circle; of a null
            raise BadInput(f"{self.path}: {name!r} is no name of a file ({error})") from None
        if not path.is_relative_to(self.folder):
            raise BadInput(
                f"{self.path}: {name!r} leads outside the scene's folder; expected a file in it"
            )
        return path

    def _prune(self, parent: ET.Element) -> None:
        """Leave out what is only seen, and refuse what is not listed."""
        for element in list(parent):
            if element.tag in _SEEN:
                parent.remove(element)
                continue
            if element.tag not in _HELD:
                raise BadInput(
                    f"{self.path}: holds <{element.tag}>, which is not supported; expected the "
                    f"rigid bodies of objects, shelf and robot"
                )
            if "builtin" in element.attrib:  # a few characters can ask for billions of triangles
                raise BadInput(f"{self.path}: holds a built-in mesh; expected meshes from files")
            element.attrib.pop("material", None)
            if element.tag == "size":  # others reserve memory
                kept = {"njmax", "nconmax", "memory"} & element.attrib.keys()
                element.attrib = {name: element.attrib[name] for name in sorted(kept)}
            self._prune(element)

    def _too_large(self, what: str, most: int) -> BadInput:
        return BadInput(
            f"{self.path}: its files are too large together, expected {what} of at most "
            f"{most // MIB} MiB"
        )


@functools.lru_cache(maxsize=64)
def _shared(content: bytes) -> bytes:
    """The first of equal contents: many scenes have one robot, and are sent away together."""
    return content


# -- the compiled model --------------------------------------------------------------------------


def _check(model: Any, n_objects: int) -> None:
    """Raise BadInput unless the robot can be driven, and is the one that the planner knows."""
    kinds = mujoco.mjtObj
    free, slide, hinge = (
        mujoco.mjtJoint.mjJNT_FREE,
        mujoco.mjtJoint.mjJNT_SLIDE,
        mujoco.mjtJoint.mjJNT_HINGE,
    )
    if model.narena > _MOST_ARENA:
        raise BadInput(
            f"size asks for {model.narena // MIB} MiB; expected at most {_MOST_ARENA // MIB} MiB"
        )
    if n_objects == 0:
        raise BadInput("no objects; expected bodies object_1, object_2, ... in the worldbody")
    for body in ("robot", "shelf", *(f"object_{i + 1}" for i in range(n_objects))):
        number = _number(model, kinds.mjOBJ_BODY, body, "body")
        if model.body_parentid[number] != 0:
            raise BadInput(f"body {body} is inside another body; expected it in the worldbody")
        joints = model.jnt_type[model.body_jntadr[number] :][: model.body_jntnum[number]]
        if body.startswith("object_") and joints.tolist() != [free]:
            raise BadInput(f"body {body} has {len(joints)} joints; expected one free joint")
    expected = [slide, slide, hinge, *[hinge] * len(FINGERS)]
    numbers = [_number(model, kinds.mjOBJ_JOINT, joint, "joint") for joint in (*BASE, *FINGERS)]
    robot = model.body("robot").id
    for joint, number, kind in zip((*BASE, *FINGERS), numbers, expected, strict=True):
        if model.jnt_type[number] != kind or model.body_rootid[model.jnt_bodyid[number]] != robot:
            word = "slide" if kind == slide else "hinge"
            raise BadInput(f"joint {joint} is of another kind; expected a {word} of the robot")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    if not np.allclose(data.xaxis[numbers[:3]], np.eye(3), atol=1e-4):
        raise BadInput(f"the axes of {', '.join(BASE)} are not x, y and z of the world")
    for site, point in zip(SITES, (EE_POINT, EE_POINT_AHEAD), strict=True):
        x, y = data.site_xpos[_number(model, kinds.mjOBJ_SITE, site, "site"), :2]
        if not np.hypot(x - point[0], y - point[1]) < _NEAR_M:
            raise BadInput(
                f"site {site} is at ({x:.4f}, {y:.4f}); expected ({point[0]:.4f}, {point[1]:.4f}),"
                f" as of the hand that the planner knows"
            )


def _number(model: Any, kind: Any, name: str, word: str) -> int:
    number = mujoco.mj_name2id(model, kind, name)
    if number < 0:
        raise BadInput(f"has no {word} {name}; expected it in the scene or its includes")
    return number
