"""Settings: names, types, ranges, the three ways in (API, --set, TOML), and the registry of techniques."""

from pathlib import Path

import pytest

from glhybrid import techniques
from glhybrid.errors import SettingError
from glhybrid.settings import Settings, rows


def test_defaults_are_the_documented_ones() -> None:
    assert Settings().to_dict() == {
        "shadows": "ray", "reflections": "ray-lerp", "ao": "none", "samples": 64, "bounces": 8, "aa": None, "exposure": "auto",
        "tone": "pbr-neutral", "terminator": False, "seed": 0, "time": None,
        "clip": None, "rebuild": 1.5, "builder": "auto", "levels": "auto", "kernels": "auto", "primary": "auto",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "key", "value"),
    [
        ("samples=16", "samples", 16),
        (" samples = 16 ", "samples", 16),
        ("exposure=-1.5", "exposure", -1.5),
        ("exposure=2", "exposure", 2.0),
        ("exposure=auto", "exposure", "auto"),
        ("aa=auto", "aa", None),
        ("aa=8", "aa", 8),
        ("tone=none", "tone", "none"),
        ("terminator=on", "terminator", True),
        ("terminator=false", "terminator", False),
        ("levels=2", "levels", 2),
        ("levels=auto", "levels", "auto"),
        ("seed=4294967295", "seed", 4294967295),
        ("shadows=none", "shadows", "none"),
        ("reflections=reference", "reflections", "reference"),
    ],
)
def test_overrides(text: str, key: str, value: object) -> None:
    got = getattr(Settings().with_overrides([text]), key)
    assert got == value and type(got) is type(value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sampels=3", 'did you mean "samples"'),
        ("samples", "expected key=value"),
        ("samples=0", "from 1 to"),
        ("samples=1.5", "whole number"),
        ("samples=", "whole number"),
        ("exposure=nan", "a number"),
        ("exposure=inf", "a number"),
        ("exposure=bright", "or auto"),
        ("tone=acess", 'did you mean "aces"'),
        ("terminator=maybe", "true or false"),
        ("levels=3", "auto, 1, 2"),
        ("seed=-1", "from 0 to 4294967295"),
        ("shadows=rai", 'did you mean "ray"'),
        ("parameters=1", "`glhybrid settings` lists all"),
    ],
)
def test_refusals_name_the_key_and_what_is_expected(text: str, says: str) -> None:
    with pytest.raises(SettingError) as caught:
        Settings().with_overrides([text])
    assert says in str(caught.value) and text.split("=")[0] in str(caught.value)


def test_the_api_checks_types_too() -> None:
    for wrong in ({"samples": "64"}, {"samples": True}, {"terminator": 1}, {"levels": True}, {"exposure": "dark"}):
        with pytest.raises(SettingError):
            Settings(**wrong)  # type: ignore[arg-type]
    assert Settings(exposure=1).exposure == 1.0  # a whole number is a number


def test_round_trip_and_identity() -> None:
    changed = Settings(shadows="none", aa=3, exposure=1.25, levels=2)
    assert Settings.from_dict(changed.to_dict()) == changed != Settings()
    assert hash(changed) == hash(Settings.from_dict(changed.to_dict()))
    assert changed.replace(aa=None) != changed


def test_toml(tmp_path: Path) -> None:
    file = tmp_path / "look.toml"
    file.write_text('shadows = "none"\nexposure = 1\naa = "auto"\n')
    assert Settings().with_toml(file) == Settings(shadows="none", exposure=1.0)
    for text, says in (("shadow = 1", "shadows"), ("samples = 'x'", "samples"), ("= 3", "not TOML")):
        file.write_text(text)
        with pytest.raises(SettingError, match=says) as caught:
            Settings().with_toml(file)
        assert str(file) in str(caught.value)
    with pytest.raises(SettingError, match="cannot be read"):
        Settings().with_toml(tmp_path / "absent.toml")


def test_frames_averaged_depend_on_the_kind_of_output() -> None:
    assert (Settings().aa_frames(data=False), Settings().aa_frames(data=True)) == (4, 1)
    assert Settings(aa=2).aa_frames(data=True) == 2


def test_parameters_of_techniques_are_dotted_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = techniques.Technique(
        "shadows", "pcf", "", parameters=(techniques.Parameter("radius", 2.0, "filter radius", 0, 64),)
    )
    monkeypatch.setitem(techniques.SHADOWS, "pcf", fake)
    monkeypatch.setattr(techniques, "parameters", techniques.parameters.__wrapped__)  # the table is kept otherwise
    settings = Settings().with_overrides(["shadows=pcf", "shadows.pcf.radius=3"])
    assert settings.parameter("shadows.pcf.radius") == 3.0 and Settings().parameter("shadows.pcf.radius") == 2.0
    assert Settings.from_dict(settings.to_dict()) == settings != Settings(shadows="pcf")
    assert ("shadows.pcf.radius", "2.0", "filter radius (a number from 0 to 64)") in rows()
    with pytest.raises(SettingError, match="from 0 to 64"):
        Settings().with_overrides(["shadows.pcf.radius=65"])
    with pytest.raises(SettingError, match=r"did you mean .shadows.pcf.radius"):
        Settings().with_overrides(["shadows.pcf.radios=1"])


def test_the_registry_has_the_documented_names() -> None:
    assert list(techniques.SHADOWS) == ["none", "map", "pcf", "pcss", "csm", "baked", "ray", "ray-soft"]
    assert list(techniques.REFLECTIONS) == [
        "none", "env", "probe", "ssr", "ray-lerp", "ssr-ray", "ray-glossy", "reference",
    ]  # fmt: skip
    for kind, table in techniques.TECHNIQUES.items():
        for name in table:
            assert techniques.find(kind, name).summary
