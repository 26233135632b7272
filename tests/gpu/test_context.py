"""Contexts: every device name, several at once, no leak; and for each way to fail, one error with its remedy."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from glhybrid import context as contexts
from glhybrid import doctor, egl, host
from glhybrid.context import Context, open_context
from glhybrid.errors import DeviceError, SettingError
from glhybrid.host import Host, Problem

if TYPE_CHECKING:
    from glhybrid.egl import EglDevice


def _try(device: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """open_context in a process of its own: drivers read most variables once."""
    code = (
        "import sys, json, logging\nfrom glhybrid.context import open_context\n"
        "from glhybrid.errors import GlhybridError\n"
        "logging.basicConfig(level='INFO', format='%(message)s')\n"
        "try:\n  with open_context(sys.argv[1]) as c: print(json.dumps(c.device.to_dict()))\n"
        "except GlhybridError as e: print(e); sys.exit(e.exit_code)"
    )
    command = [sys.executable, "-c", code, device]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | environment)


def _software() -> Context:
    try:
        return open_context("software")
    except DeviceError as error:
        pytest.skip(f"no software renderer: {error}")


def test_a_context_knows_its_device_and_limits(context: Context) -> None:
    device, limits = context.device, context.limits
    assert device.backend == "egl" and device.renderer and device.vendor
    assert re.match(r"4\.[3-9]", device.version)
    assert device.software == ("llvmpipe" in device.renderer)
    assert str(device).count("software" if device.software else "GPU") >= 1
    json.dumps(device.to_dict() | limits.to_dict())
    assert limits.storage_block_bytes >= 1 << 24 and limits.work_group_count >= (65535,) * 3
    assert context.gl.version_code >= 430


def test_the_software_renderer_by_name_and_by_number() -> None:
    with _software() as first:
        assert first.device.software
        if first.device.egl_index is not None:
            with open_context(f"egl:{first.device.egl_index}") as second:
                assert second.device == first.device


def test_contexts_live_side_by_side() -> None:
    with _software() as first, _software() as second:
        first.make_current()
        buffer = first.gl.buffer(b"first context")
        second.make_current()
        other = second.gl.buffer(b"second context")
        assert other.read() == b"second context"
        second.close()
        second.close()
        first.make_current()
        assert buffer.read() == b"first context"
        assert first.raw.errors() == []
        with first.gl:  # moderngl's own way of switching
            assert buffer.read() == b"first context"


def test_contexts_are_freed() -> None:
    def resident_mib() -> float:
        try:
            pages = int(Path("/proc/self/statm").read_text().split()[1])
        except OSError:
            pytest.skip("no /proc/self/statm")
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    for _ in range(3):
        _software().close()
    before = resident_mib()
    for _ in range(30):
        _software().close()
    assert resident_mib() - before < 15  # a leaked llvmpipe context is about 2 MiB, 30 of them 60


@pytest.mark.parametrize(
    ("name", "kind", "says"),
    [
        ("sofware", SettingError, 'did you mean "software"'),
        ("egl:", SettingError, "unknown device"),
        ("egl:-1", SettingError, "unknown device"),
        ("egl:99", DeviceError, "no EGL device 99; this machine has: egl:0"),
        ("cuda:99", DeviceError, "CUDA ordinal 99"),
    ],
)
def test_names_that_mean_nothing_here(context: Context, name: str, kind: type[Exception], says: str) -> None:
    with pytest.raises(kind, match=re.escape(says)):
        open_context(name)


def test_gpu_is_a_gpu_or_an_error() -> None:
    try:
        with open_context("gpu") as opened:
            assert not opened.device.software
    except DeviceError as error:
        assert "no GPU" in str(error) and ("--device auto" in str(error) or "to mend" in str(error))


def test_the_environment_names_the_default(context: Context) -> None:
    done = _try("auto", GLHYBRID_DEVICE="egl:99")
    assert done.returncode == 3 and "no EGL device 99" in done.stdout
    assert contexts.open_context.__doc__ and "GLHYBRID_DEVICE" in contexts.open_context.__doc__


def test_one_log_line_says_which(context: Context) -> None:
    done = _try("auto")
    assert done.returncode == 0, done.stdout
    device = json.loads(done.stdout)
    (line,) = [x for x in done.stderr.splitlines() if x.startswith("device: ")]
    assert device["renderer"] in line and ("software" if device["software"] else "GPU") in line


def test_a_driver_below_4_3_is_named_with_its_version() -> None:
    with _software() as opened:
        number = opened.device.egl_index
    if number is None:
        pytest.skip("the software renderer is not an EGL device")
    done = _try(f"egl:{number}", MESA_GL_VERSION_OVERRIDE="4.2")
    assert done.returncode == 3
    assert "OpenGL 4.2" in done.stdout and "below 4.3" in done.stdout and done.stdout.count("\n") == 1


def test_no_driver_at_all_says_what_to_install(tmp_path: Path) -> None:
    for device in ("egl:0", "software"):
        done = _try(device, __EGL_VENDOR_LIBRARY_DIRS=str(tmp_path))
        if "osmesa" in done.stdout:
            continue  # `software` found OSMesa instead
        assert done.returncode == 3 and host.MESA_FIX in done.stdout and done.stdout.count("\n") == 1
    done = _try("egl:0", __EGL_VENDOR_LIBRARY_FILENAMES="/nonexistent.json")
    assert done.returncode == 3 and "/nonexistent.json cannot be read" in done.stdout
    assert "unset __EGL_VENDOR_LIBRARY_FILENAMES" in done.stdout


def test_a_vendor_file_without_its_library_is_noticed(tmp_path: Path) -> None:
    file = tmp_path / "50_gone.json"
    file.write_text('{"file_format_version": "1.0.0", "ICD": {"library_path": "libEGL_gone_mesa.so.0"}}')
    done = _try("gpu", __EGL_VENDOR_LIBRARY_FILENAMES=str(file))
    assert done.returncode == 3 and "libEGL_gone_mesa.so.0 is named" in done.stdout and host.MESA_FIX in done.stdout


def test_no_libegl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host, "_open", lambda name: None)
    host.find_osmesa.cache_clear()
    try:
        for name in ("auto", "software", "gpu", "egl:0", "cuda:0"):
            with pytest.raises(DeviceError, match=r"libEGL\.so\.1 is missing; to mend: apt-get install"):
                open_context(name)
        with pytest.raises(DeviceError, match="apt-get install -y libosmesa6"):
            open_context("osmesa")
        report = doctor.examine()
    finally:
        host.find_osmesa.cache_clear()
    assert not report.usable and not report.devices
    assert report.problems[0].fix == host.MESA_FIX
    json.dumps(report.to_dict())


def test_osmesa() -> None:
    if host.find_osmesa() is None:
        pytest.skip(f"no libOSMesa: {host.OSMESA_FIX}")
    done = _try("osmesa")  # alone in its process, as it would be used
    assert done.returncode == 0, done.stdout
    device = json.loads(done.stdout)
    assert device["backend"] == "osmesa" and device["software"] and device["egl_index"] is None


def test_osmesa_beside_egl() -> None:
    if host.find_osmesa() is None:
        pytest.skip(f"no libOSMesa: {host.OSMESA_FIX}")
    code = (
        "from glhybrid.context import open_context\n"
        "a = open_context('software'); b = open_context('osmesa')\n"
        "y = b.gl.buffer(b'osmesa'); a.make_current(); x = a.gl.buffer(b'egl')\n"
        "b.make_current(); assert y.read() == b'osmesa'; a.make_current(); assert x.read() == b'egl'\n"
        "b.close(); assert x.read() == b'egl'; a.make_current(); assert x.read() == b'egl'; a.close()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_compute_shader_that_runs_wrongly_is_refused(monkeypatch: pytest.MonkeyPatch, context: Context) -> None:
    monkeypatch.setattr(contexts, "_CANARY", contexts._CANARY.replace("+ 7u", "+ (l == 5u ? 8u : 7u)"))
    with pytest.raises(DeviceError, match="runs compute shaders wrongly: 4 of 256"):
        contexts._canary(context.gl, context.device)
    monkeypatch.setattr(contexts, "_CANARY", "#version 430\nnonsense")
    with pytest.raises(DeviceError, match="cannot run a compute shader"):
        contexts._canary(context.gl, context.device)


def test_limits_below_the_standards_minimum_are_refused(context: Context) -> None:
    with pytest.raises(DeviceError, match="image_units 4 < 8"):
        contexts._require(replace(context.limits, image_units=4), context.device)


def test_devices_are_tried_gpus_first() -> None:
    def device(index: int, **facts: object) -> "EglDevice":
        return egl.EglDevice(index, index + 1, **facts)  # type: ignore[arg-type]

    listed = [
        device(0, software=True), device(1, drm_node="/dev/dri/card0"), device(2, cuda=1), device(3, cuda=0), device(4),
    ]  # fmt: skip
    assert [d.index for d in egl.preference(listed)] == [3, 2, 1, 4, 0]
    assert "cuda:1" in str(listed[2]) and "software" in str(listed[0])


@pytest.mark.parametrize(
    ("renderer", "software"),
    [
        ("llvmpipe (LLVM 15.0.6, 256 bits)", True),
        ("zink Vulkan 1.3(llvmpipe (LLVM 19.1.0, 256 bits) (LAVAPIPE))", True),
        ("softpipe", True),
        ("ANGLE (Google, Vulkan 1.3.0 (SwiftShader Device (Subzero)), SwiftShader driver)", True),
        ("NVIDIA H100 80GB HBM3/PCIe/SSE2", False),
        ("Mesa Intel(R) UHD Graphics 620 (KBL GT2)", False),
        ("AMD Radeon RX 7900 XTX (radeonsi, navi31, LLVM 19.1.1, DRM 3.59)", False),
        ("D3D12 (NVIDIA GeForce RTX 3080)", False),
    ],
)
def test_software_renderers_by_name(renderer: str, software: bool) -> None:
    assert contexts.is_software(renderer) == software


_HEALTHY = Host(
    libegl=True, libosmesa=False, egl_vendors=("libEGL_mesa.so.0",), broken_vendors=(), container="",
    nvidia_driver="", nvidia_gl=False,
    nvidia_capabilities="", dri_nodes=(), dri_denied=(), environment={},
)  # fmt: skip


@pytest.mark.parametrize(
    ("facts", "what", "fix"),
    [
        ({}, None, None),
        ({"libegl": False, "egl_vendors": ()}, "libEGL.so.1 is missing", host.MESA_FIX),
        ({"egl_vendors": ()}, "has no driver", host.MESA_FIX),
        ({"broken_vendors": ("libEGL_mesa.so.0",)}, "libEGL_mesa.so.0 is named", host.MESA_FIX),
        (
            {"nvidia_driver": "550.54.15", "container": "docker", "nvidia_capabilities": "compute,utility"},
            "NVIDIA_DRIVER_CAPABILITIES=compute,utility",
            host.NVIDIA_FIX,
        ),
        ({"nvidia_driver": "550.54.15"}, "this machine lacks its OpenGL", "apt-get install -y libnvidia-gl-550"),
        ({"nvidia_gl": True}, "libEGL is not told of it", "10_nvidia.json"),
        ({"dri_denied": ("/dev/dri/renderD128",)}, "no right to open /dev/dri/renderD128", "usermod -aG render,video"),
        (
            {"environment": {"LIBGL_ALWAYS_SOFTWARE": "1"}, "dri_nodes": ("/dev/dri/card0",)},
            "LIBGL_ALWAYS_SOFTWARE forces software",
            "unset LIBGL_ALWAYS_SOFTWARE",
        ),
        ({"environment": {"LIBGL_ALWAYS_SOFTWARE": "1"}}, None, None),  # there is no GPU to miss
        ({"egl_vendors": ("libEGL_nvidia.so.0",)}, "Mesa, the software renderer, is not", host.MESA_FIX),
    ],
)
def test_problems_come_with_the_line_that_mends_them(
    facts: dict[str, object], what: str | None, fix: str | None
) -> None:
    found: list[Problem] = host.problems(replace(_HEALTHY, **facts))  # type: ignore[arg-type]
    if what is None:
        assert found == []
    else:
        assert fix is not None
        assert any(what in p.what and fix in p.fix for p in found), found


def test_doctor_tries_every_device(context: Context, capsys: pytest.CaptureFixture[str]) -> None:
    report = doctor.examine()
    assert report.usable and any(p.ok and p.limits["texture_size"] >= 16384 for p in report.devices)
    assert {x.name for x in report.libraries if x.version} >= {"moderngl", "numpy"}
    assert json.loads(json.dumps(report.to_dict()))["usable"] is True
    doctor.show(report)
    out = capsys.readouterr().out
    assert f"--device auto takes {report.auto}" in out and "storage_block_bytes" in out


def test_doctor_survives_a_driver_that_crashes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    crash = tmp_path / "python"
    crash.write_text('#!/bin/sh\ncase "$*" in *--list*) echo \'{"devices": ["egl:0"]}\';; *) kill -SEGV $$;; esac\n')
    crash.chmod(0o755)
    monkeypatch.setattr(doctor.sys, "executable", str(crash))
    probes = doctor._probes(_HEALTHY)
    assert [(p.name, p.ok) for p in probes] == [("egl:0", False)]
    assert "crashed (SIGSEGV)" in probes[0].error and probes[0].fix


_READ = """#version 430
layout(local_size_x = 64) in;
layout(std430, binding = 0) readonly buffer Given { uint given[]; };
layout(std430, binding = 1) buffer Seen { uint seen[]; };
uniform int turn;
void main() {
    uint busy = gl_GlobalInvocationID.x;
    for (int i = 0; i < 300; i++) busy = busy * 1664525u + 1013904223u;
    if (busy != 1u) seen[turn] = given[0];
}
"""
_TAKE = """#version 430
layout(local_size_x = 1) in;
layout(std430, binding = 0) buffer Other { uint other[]; };
void main() { other[0] += 1u; }
"""


def test_what_is_written_waits_its_turn(context: Context) -> None:
    """Without the binding in Context.write, an H100 shows a dispatch what was written for one six turns later."""
    turns = 64
    read, take = context.gl.compute_shader(_READ), context.gl.compute_shader(_TAKE)
    given, seen, other = (context.gl.buffer(reserve=4 * n) for n in (44, turns, 1))
    for turn in range(turns):
        other.bind_to_storage_buffer(0)  # so that nothing says that `given` is still being read
        take.run()
        context.gl.memory_barrier()
        context.write(given, np.full(44, 1000 + turn, np.uint32))
        given.bind_to_storage_buffer(0)
        seen.bind_to_storage_buffer(1)
        read["turn"] = turn
        read.run(64)
        context.gl.memory_barrier()
    np.testing.assert_array_equal(np.frombuffer(seen.read(), np.uint32), 1000 + np.arange(turns))
    for made in (read, take, given, seen, other):
        made.release()
    context.bindings.forget()
