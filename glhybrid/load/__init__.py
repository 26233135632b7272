"""Files to `Scene`: pure data, no OpenGL. `load` is the one door; the modules beside it read one kind of file each."""

from dataclasses import replace
from pathlib import Path

from glhybrid.errors import LoadError, unknown
from glhybrid.load import builtin
from glhybrid.scene import Camera, Scene

__all__ = ["default_camera", "load", "read_model", "with_defaults"]

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".off")
GLTF_SUFFIXES = (".gltf", ".glb")
SUFFIXES = (*GLTF_SUFFIXES, *MESH_SUFFIXES, ".toml")


def load(source: str | Path, *, strict: bool = False, allow_outside: bool = False, smooth: bool = False) -> Scene:
    """The scene of a glTF, GLB, OBJ, PLY, STL or OFF file, of a scene TOML, or of a built-in scene's name.

    strict: whatever would be dropped or changed is an error. allow_outside: files that a file names may lie outside its
    folder. smooth: smooth normals where the file has none.
    A scene without camera gets one that frames it; one without light and environment a soft sky and sun (design.md 3);
    both are said in Scene.warnings.
    Raises LoadError with one message.
    """
    path = _find(source)
    if path.suffix.lower() == ".toml":
        from glhybrid.load.scenefile import load_scene_file

        scene = load_scene_file(path, strict=strict, allow_outside=allow_outside)
        if smooth:
            scene = scene.replace(
                warnings=(*scene.warnings, "smooth is set by each [[object]] of a scene file: ignored")
            )
    else:
        scene = read_model(path, strict=strict, allow_outside=allow_outside, smooth=smooth)
    if strict and scene.warnings:
        raise LoadError(f"{path}: {scene.warnings[0]} (strict: nothing may be dropped or changed)")
    return with_defaults(scene)


def read_model(path: Path, *, strict: bool = False, allow_outside: bool = False, smooth: bool = False) -> Scene:
    """One model file as it is, without default camera or light."""
    suffix = path.suffix.lower()
    if suffix in GLTF_SUFFIXES:
        from glhybrid.load.gltf import load_gltf

        return load_gltf(path, strict=strict, smooth=smooth, allow_outside=allow_outside)
    if suffix in MESH_SUFFIXES:
        from glhybrid.load.mesh import load_mesh

        return load_mesh(path, strict=strict, smooth=smooth, allow_outside=allow_outside)
    raise LoadError(f'{path}: cannot read "{suffix}" files; supported: {", ".join(SUFFIXES)}')


def default_camera(scene: Scene) -> Camera:
    """A camera from the front, a bit right and above, that sees the whole scene in images of any shape."""
    from glhybrid.load import defaults

    return defaults.default_camera(scene)


def _find(source: str | Path) -> Path:
    """The file to read: a path with a known suffix, else a built-in scene. Refuses what is neither, with the reason."""
    path, text = Path(source).expanduser(), str(source)
    if path.suffix.lower() not in SUFFIXES:
        if (found := builtin.scene_path(text)) and not path.is_file():
            return found
        if path.is_dir():
            raise LoadError(f"{path}: is a folder; name the model in it ({', '.join(SUFFIXES)})")
        if path.suffix or path.exists() or (len(path.parts) > 1 and path.parts[0] != "failures"):
            what = f'"{path.suffix}" files' if path.suffix else "a file without suffix"
            exists = "" if path.exists() else " (nor is there such a file)"
            raise LoadError(f"{path}: cannot read {what}{exists}; supported: {', '.join(SUFFIXES)}")
        # Failures are found where they are meant, and not listed where they are not.
        known = [n for n in builtin.scene_names() if n.startswith("failures/") == text.startswith("failures/")]
        raise LoadError(f"{unknown('built-in scene', text, known)}; or name a file ({', '.join(SUFFIXES)})")
    try:
        if path.is_dir():
            raise LoadError(f"{path}: is a folder; name the model in it ({', '.join(SUFFIXES)})")
        with path.open("rb"):
            return path
    except FileNotFoundError:
        raise LoadError(f"{path}: there is no such file") from None
    except OSError as error:
        raise LoadError(f"{path}: cannot be read: {error.strerror or error}") from error


def with_defaults(scene: Scene) -> Scene:
    """As load() gives scenes back: with a camera that frames it, and a soft sky and sun, where it has none.

    For scenes built in code; each thing added is said in Scene.warnings.
    """
    said = []
    if scene.lights and scene.cameras:
        return scene
    from glhybrid.deform import at_rest

    resting = at_rest(scene)  # what is lit and framed is what will be drawn
    if not scene.lights and scene.environment is None:
        from glhybrid.load.defaults import default_light, faces_away

        environment, sun = default_light(behind=not scene.cameras and faces_away(resting))
        scene = replace(scene, environment=environment, lights=(sun,))
        said.append("no light and no environment: lit by a soft default sky and sun")
    if not scene.cameras:
        scene = replace(scene, cameras=(default_camera(resting),))
        said.append("no camera: seen by a default one that frames the scene")
    return replace(scene, warnings=(*scene.warnings, *said))
