"""Scene files that are refused: where the fault is and what it is, in one sentence."""

from pathlib import Path

import pytest
from scenefile_kit import BOX, STUDY, model, scene

from glhybrid.errors import LoadError

BAD = [
    ("[camra.main]", 'hall.toml: unknown key "camra"; did you mean "camera"?'),
    ("a = ", "hall.toml: not valid TOML"),
    ("[camera.main]\neye = [0,0,0]", "hall.toml: [camera.main]: needs target"),
    (
        "[camera.main]\neye = [0,0,0]\ntarget = [0,0,0]",
        "[camera.main]: target = [0, 0, 0]: must not be where the eye is",
    ),
    ("[camera.main]\neye = [0,0,0]\ntarget = [0,0,1]\nup = [0,0,0]", "up = [0, 0, 0]: must not be zero"),
    ("[camera.main]\neye = [0,0,0]\ntarget = [0,0,1]\nfov_y_deg = 180", "fov_y_deg = 180: must be between 0 and 180"),
    ("[camera.main]\neye = [0,0,0]\ntarget = [0,0,1]\nnear = 0", "near = 0: must be greater than 0"),
    ("[camera.main]\neye = [0,0,0]\ntarget = [0,0,1]\nfov = 1", 'unknown key "fov"; did you mean "fov_y_deg"?'),
    ("[camera.main]\neye = [0,0,nan]\ntarget = [0,0,1]", "must be finite"),
    ("[camera.main]\neye = [0,0]\ntarget = [0,0,1]", "eye = [0, 0]: must be a list of 3 numbers"),
    ("camera = 3", "camera = 3: must hold named tables: write [camera.main]"),
    ("[camera]\neye = [0,0,0]", "write [camera.main]"),
    ("[environment]\nintensity = 1", "hall.toml: [environment]: needs exactly one of file, constant, sky"),
    ("[environment]\nconstant = [1,1,1]\nsky = {}", "has constant and sky"),
    ("[environment]\nconstant = [1,1,-1]", "must not be negative"),
    ("[environment]\nsky = {turbidity = 0}", "hall.toml: [environment]: sky: turbidity = 0: must be between 1 and 10"),
    ("[environment]\nsky = {sun_elevation = 3}", 'did you mean "sun_elevation_deg"?'),
    ('[environment]\nfile = "no.hdr"', 'file = "no.hdr": there is no file'),
    ('[environment]\nfile = "."', "is not a file"),
    ("[[light]]", 'hall.toml: [[light]] 1: needs kind = "directional"'),
    ('[[light]]\nkind = "sun"', 'unknown kind "sun"'),
    ('[[light]]\nkind = "point"', "a point light needs position"),
    ('[[light]]\nkind = "point"\nposition = [0,0,0]\ndirection = [1,0,0]', "does not apply to a point light"),
    ('[[light]]\nkind = "directional"\ndirection = [0,0,0]', "direction = [0, 0, 0]: must not be zero"),
    ('[[light]]\nkind = "directional"\nintensity = -1', "intensity = -1: must not be negative"),
    (
        '[[light]]\nname = "key"\nkind = "spot"\nposition = [0,0,0]\ninner_cone_deg = 30\nouter_cone_deg = 20',
        'hall.toml: [[light]] 1 "key": inner_cone_deg = 30: must be less than outer_cone_deg (20)',
    ),
    ("[light]\nkind = 3", "must be an array of tables: write [[light]]"),
    ("[[material]]", "a material needs a name"),
    ('[[material]]\nname = "a"\n[[material]]\nname = "a"', "another material has this name already"),
    (
        '[[material]]\nname = "a"\nroughness = 2',
        'hall.toml: [[material]] 1 "a": roughness = 2: must be between 0 and 1',
    ),
    ('[[material]]\nname = "a"\nrougness = 0', 'did you mean "roughness"?'),
    ('[[material]]\nname = "a"\nalpha_mode = "CUT"', 'unknown alpha_mode "CUT"'),
    ('[[material]]\nname = "a"\nunlit = 1', "unlit = 1: must be true or false"),
    ('[[material]]\nname = "a"\nbase_color = "red"', 'base_color = "red": must be a list of 4 numbers'),
    ('[[material]]\nname = "a"\ntextures = { base_colour = "a.png" }', 'textures: unknown key "base_colour"'),
    ('[[material]]\nname = "a"\ntextures = { normal = "no.png" }', 'normal = "no.png": there is no file'),
    ('[[material]]\nname = "a"\ntextures = { normal = { pattern = "marbel" } }', 'did you mean "marble"?'),
    (
        '[[material]]\nname = "a"\ntextures = { normal = { pattern = "noise", cells = [0, 1] } }',
        "cells = [0, 1]: must be",
    ),
    ('[[material]]\nname = "a"\ntextures = { normal = {} }', "needs either file or pattern"),
    (BOX + "scale = 1e30", "scale = 1e+30: must not be 0, and between 1e-9 and 1e9"),
    (BOX + "translate = [1e13, 0, 0]", "must be within 1e12 m"),
    (BOX + "size = [1e30, 1, 1]", "greater than 0 and at most 1e9"),
    ('[[light]]\nkind = "directional"\nintensity = 1e300', "nor greater than 1e15"),
    ("[camera.main]\neyes = [0,0,1]\ntarget = [0,0,0]", 'unknown key "eyes"; did you mean "eye"?'),
    ('[[light]]\nkinds = "point"', 'unknown key "kinds"; did you mean "kind"?'),
    ('[[material]]\nnam = "a"', 'unknown key "nam"; did you mean "name"?'),
    ('[[material]]\nname = ""', "must not be empty"),
    ('[[object]]\nshap = "box"', 'unknown key "shap"; did you mean "shape"?'),
    (BOX + "scale = 0", "hall.toml: [[object]] 1: scale = 0: must not be 0"),
    (BOX + 'name = "lamp"\nscale = [1,0,1]', 'hall.toml: [[object]] 1 "lamp": scale = [1, 0, 1]: must not be 0'),
    (BOX + "count = 0\nstep = [1,0,0]", "count = 0: must be between 1 and"),
    (BOX + "count = [1,2.5,1]\nstep = [1,1,0]", "must be whole and at least 1"),
    (BOX + "count = 3", "count = 3: needs a step that is not 0 where it repeats"),
    (BOX + "count = [2,2,1]\nstep = [1,0,0]", "needs a step that is not 0"),
    (BOX + "count = 2000000\nstep = [1,0,0]", "more than 1000000 instances"),
    (BOX + "count = true", "count = true: must be a whole number"),
    (BOX + 'material = "wod"\n[[material]]\nname = "wood"', 'unknown material "wod"; did you mean "wood"?'),
    (BOX + "size = [1,-1,1]", "[[object]] 1: size = [1, -1, 1]: must be greater than 0"),
    (BOX + "radius = 1", 'unknown key "radius"'),
    (BOX + "smooth = true", 'unknown key "smooth"'),
    ('[[object]]\nshape = "bax"', 'unknown shape "bax"; did you mean "box"?'),
    ("[[object]]", "needs either file or shape"),
    (BOX + 'file = "a.glb"', "needs either file or shape"),
    ('[[object]]\nfile = "no.glb"', 'hall.toml: [[object]] 1: file = "no.glb": there is no file'),
    ('[[object]]\nfile = "hall.toml"', "a scene file inside a scene file is not supported"),
    ('[[object]]\nfile = "/etc/passwd"', "lies outside the scene file's folder"),
    ('[[object]]\nfile = "../x.glb"', "use --allow-outside"),
    ('[[object]]\nshape = "grid"\ncells = [5000, 5]', "cells = [5000, 5]: must be between 1 and 4096"),
    ('[[object]]\nshape = "grid"\ncells = [2.5, 5]', "must be whole numbers"),
    ('[[object]]\nshape = "torus"\nsegments = 3.5', "segments = 3.5: must be a whole number"),
]


@pytest.mark.parametrize(("text", "says"), BAD, ids=[f"{i}" for i in range(len(BAD))])
def test_bad_files_say_where_and_what(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(LoadError) as caught:
        scene(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "hall.toml")) and says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_outside_files_are_allowed_when_asked(tmp_path: Path) -> None:
    model(tmp_path / "m.gltf")
    inner = tmp_path / "scenes"
    inner.mkdir()
    text = '[[object]]\nfile = "../m.gltf"'
    with pytest.raises(LoadError, match="outside"):
        scene(inner, text)
    (inner / "link.gltf").symlink_to(tmp_path / "m.gltf")
    with pytest.raises(LoadError, match="outside"):
        scene(inner, text.replace("../m", "link"))
    assert len(scene(inner, text, allow_outside=True).instances) == 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("title", "titel", r'unknown key "titel"; did you mean "title"'),
        ('why = "texels"', "", "needs why"),
        ("[64, 48]", "[64, 0]", "size = .*whole and between 1 and 8192"),
        ("[30, 50]", "[50, 30]", "the lowest value comes first"),
        ("expected = [30, 50]", "", r"\[\[fails\]\] 1: needs expected"),
        ("expected = [30, 50]", "expect = [30, 50]", r'unknown key "expect"; did you mean "expected"'),
        ('because = "half"', "", "needs because"),
        ('because = "half"', 'because = "half"\nbar = 3', 'unknown key "bar"'),
        ('set = { shadows = "ray" }', "", "needs either set, .*, or control"),
        ("[[study", "[[studies", r'unknown key "studies"; did you mean "study"|needs \[\[study.fails\]\]'),
        ('set = { reflections = "none" }', "set = 3", "set = 3: must be a table"),
    ],
)
def test_study_table_is_read_strictly(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in STUDY
    with pytest.raises(LoadError, match=message):
        scene(tmp_path, STUDY.replace(old, new))
