"""The choice of backend.  The hard requirement: never an abort, always one clear line."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from slbench.core.errors import InputError
from slbench.simulate.render import BackendError
from slbench.simulate.render.backend import choice as backend
from slbench.simulate.render.backend import llvm, probe

ROOT = Path(__file__).resolve().parents[3]
OLD_LLVM = {major: Path(f"/usr/lib/x86_64-linux-gnu/libLLVM-{major}.so.1") for major in (14, 15)}


@pytest.fixture
def bare(tmp_path, monkeypatch):
    """A machine without any LLVM: no wheel, an empty prefix, an empty system folder."""
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.delenv("SLBENCH_VARIANT", raising=False)
    for name in ("prefix/lib", "system", "wheel"):
        (tmp_path / name).mkdir(parents=True)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "prefix"))
    monkeypatch.setattr(sys, "base_prefix", str(tmp_path / "prefix"))
    monkeypatch.setattr(llvm.site, "getuserbase", lambda: str(tmp_path / "user"))
    monkeypatch.setattr(llvm, "_system_folders", lambda: [tmp_path / "system"])
    monkeypatch.setattr(llvm.importlib.metadata, "files", lambda name: [])
    return tmp_path


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in a child, as a user's script that reports errors as the command line does."""
    indented = "\n".join("    " + line for line in code.splitlines())
    script = (
        "import sys\nfrom slbench.core.errors import InputError\n"
        f"try:\n{indented}\n"
        "except InputError as error:\n    print(error)\n    sys.exit(2)\n"
    )
    clean = {k: v for k, v in os.environ.items() if k not in ("DRJIT_LIBLLVM_PATH",)}
    # Beside what this process has: a site of packages may be there.
    places = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    environment = {"PYTHONPATH": places, "SLBENCH_VARIANT": "llvm_ad_mono", **environment}
    return subprocess.run(
        [sys.executable, "-c", script],
        env={**clean, **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


class TestLibraryVersion:
    @pytest.mark.parametrize(
        ("name", "version"),
        [
            ("libLLVM.so.23.1", (23, 1)),
            ("libLLVM-14.so.1", (14,)),
            ("libLLVM-14.0.6.so.1", (14, 0, 6)),
            ("libLLVM-18.so", (18,)),
            ("libLLVM.so.19.1", (19, 1)),
            ("libLLVM-17.dylib", (17,)),
            ("libLLVM.20.1.dylib", (20, 1)),
        ],
    )
    def test_the_name_tells(self, name, version, monkeypatch):
        monkeypatch.setattr(llvm, "ask_probe", lambda *_: pytest.fail("not to be loaded"))
        assert llvm.library_version(Path("/nowhere") / name) == (version, "")

    @pytest.mark.parametrize("name", ["libLLVM.so", "LLVM-C.dll", "libLLVM.so.1", "libLLVM.dylib"])
    def test_the_library_is_asked_where_the_name_does_not_tell(self, name, monkeypatch):
        monkeypatch.setattr(llvm, "ask_probe", lambda kind, path: {"version": [21, 0, 3]})
        assert llvm.library_version(name) == ((21, 0, 3), "")

    def test_a_link_counts_as_what_it_points_to(self, tmp_path):
        (tmp_path / "libLLVM-15.so.1").touch()
        (tmp_path / "libLLVM-18.so").symlink_to("libLLVM-15.so.1")
        assert llvm.library_version(tmp_path / "libLLVM-18.so") == ((15,), "")

    def test_a_file_that_is_no_library(self, tmp_path):
        (tmp_path / "libLLVM.so").write_text("not a library")
        version, problem = llvm.library_version(tmp_path / "libLLVM.so")
        assert version is None
        assert "does not load" in problem

    def test_the_library_itself_agrees_with_its_name(self):
        path, version = llvm.find_llvm()
        asked = llvm.ask_probe("llvm", str(path))["version"]
        assert tuple(asked[: len(version)]) == version

    def test_a_dying_child_is_a_problem_and_not_an_exception(self, monkeypatch):
        monkeypatch.setattr(sys, "executable", "/nonexistent/python")
        assert "failed" in llvm.ask_probe("gpu")["problem"]


class TestFindLlvm:
    def test_nothing_says_what_to_install(self, bare):
        with pytest.raises(BackendError, match=r"got none$") as caught:
            llvm.find_llvm()
        assert llvm.advice() in str(caught.value)
        assert "\n" not in str(caught.value)

    def test_advice_names_the_platforms_own_way(self):
        assert "pip install karellen-llvm-core" in llvm.advice("linux")
        assert "brew install llvm" in llvm.advice("darwin")
        assert "LLVM installer" in llvm.advice("win32")

    def test_only_old_ones_are_refused_by_name(self, bare):
        for name in ("libLLVM-14.so.1", "libLLVM-15.so.1", "libLLVM.so.16.0"):
            (bare / "system" / name).touch()
        with pytest.raises(BackendError, match=r"only older ones .*libLLVM-15\.so\.1"):
            llvm.find_llvm()

    def test_the_newest_of_the_system(self, bare):
        for name in ("libLLVM-9.so", "libLLVM-17.so.1", "libLLVM.so.19.1", "libLLVM-15.so.1"):
            (bare / "system" / name).touch()
        assert llvm.find_llvm() == (bare / "system" / "libLLVM.so.19.1", (19, 1))

    def test_environment_before_system_and_wheel_before_both(self, bare, monkeypatch):
        (bare / "system" / "libLLVM.so.22.1").touch()
        (bare / "prefix/lib" / "libLLVM.so.21.1").touch()
        assert llvm.find_llvm()[1] == (21, 1)
        (bare / "wheel" / "libLLVM.so.20.1").touch()
        # The record lists links that were never made, and another file of the package.
        names = ["libLLVM.so", "libLLVM-20.so", "libLLVM.so.20.1", "RECORD"]
        record = [
            SimpleNamespace(name=name, locate=lambda name=name: bare / "wheel" / name)
            for name in names
        ]
        monkeypatch.setattr(llvm.importlib.metadata, "files", lambda name: record)
        assert llvm.find_llvm() == (bare / "wheel" / "libLLVM.so.20.1", (20, 1))

    def test_the_users_choice_comes_first(self, bare, monkeypatch):
        (bare / "prefix/lib" / "libLLVM.so.23.1").touch()
        chosen = bare / "libLLVM-17.so.1"
        chosen.touch()
        monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(chosen))
        assert llvm.find_llvm() == (chosen, (17,))

    @pytest.mark.parametrize("name", ["libLLVM-16.so.1", "absent/libLLVM-20.so", ".", "libc.txt"])
    def test_a_bad_choice_is_refused_although_a_good_one_exists(self, name, bare, monkeypatch):
        (bare / "prefix/lib" / "libLLVM.so.23.1").touch()
        (bare / "libLLVM-16.so.1").touch()
        (bare / "libc.txt").touch()
        monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(bare / name))
        with pytest.raises(InputError, match=r"^DRJIT_LIBLLVM_PATH: expected .*LLVM 17 or newer"):
            llvm.find_llvm()


class FakeCuda:
    """The part of the CUDA driver that the probe uses."""

    def __init__(self, init=0, driver=12040, devices=(("GPU A", 9, 0),)):
        self.init, self.driver, self.devices = init, driver, devices

    def cuInit(self, flags):
        return self.init

    def cuDriverGetVersion(self, out):
        out._obj.value = self.driver

    def cuDeviceGetCount(self, out):
        out._obj.value = len(self.devices)

    def cuDeviceGet(self, out, index):
        out._obj.value = index
        return 0

    def cuDeviceGetAttribute(self, out, attribute, device):
        out._obj.value = self.devices[device.value][{75: 1, 76: 2}[attribute]]

    def cuDeviceGetName(self, buffer, size, device):
        buffer.value = self.devices[device.value][0].encode()


class TestProbe:
    def install(self, monkeypatch, libraries):
        def load(name):
            if name not in libraries:
                raise OSError(f"no {name}")
            return libraries[name]

        monkeypatch.setattr(probe.sys, "platform", "linux")
        monkeypatch.setattr(probe.ctypes, "CDLL", load)
        for variable in ("DRJIT_LIBCUDA_PATH", "DRJIT_LIBOPTIX_PATH"):
            monkeypatch.delenv(variable, raising=False)

    @pytest.mark.parametrize(
        ("cuda", "problem"),
        [
            (None, "no NVIDIA driver"),
            (FakeCuda(init=100), "cuInit returned 100"),
            (FakeCuda(driver=11080), "CUDA 11.8, and 12.2 is needed"),
            (FakeCuda(devices=()), "none of 0"),
            (FakeCuda(devices=(("Pascal", 6, 1), ("Volta", 7, 0))), "none of 2"),
        ],
    )
    def test_an_unusable_gpu_says_why(self, cuda, problem, monkeypatch):
        libraries = {"libnvoptix.so.1": object()} | ({"libcuda.so.1": cuda} if cuda else {})
        self.install(monkeypatch, libraries)
        assert problem in probe.gpu()["problem"]

    def test_a_driver_without_optix(self, monkeypatch):
        self.install(monkeypatch, {"libcuda.so.1": FakeCuda()})
        assert "without OptiX" in probe.gpu()["problem"]

    def test_the_first_gpu_that_will_do(self, monkeypatch):
        cuda = FakeCuda(devices=(("Pascal", 6, 1), ("Turing", 7, 5), ("Hopper", 9, 0)))
        self.install(monkeypatch, {"libcuda.so.1": cuda, "libnvoptix.so.1": object()})
        assert probe.gpu() == {"name": "Turing"}

    def test_a_library_without_a_version_is_too_old(self, monkeypatch):
        self.install(monkeypatch, {"libLLVM.so": object()})
        assert "older than LLVM 16" in probe.llvm_version("libLLVM.so")["problem"]


class TestChoose:
    @pytest.fixture(autouse=True)
    def machine(self, bare, monkeypatch):
        self.path = bare / "system" / "libLLVM.so.20.1"
        self.path.touch()
        self.patch = monkeypatch
        self.gpu(None)

    def gpu(self, name):
        self.patch.setattr(backend, "find_gpu", lambda: (name, "" if name else "there is none"))

    def test_the_processor_without_a_gpu(self):
        chosen = backend.choose()
        assert (chosen.variant, chosen.llvm_path) == ("llvm_ad_mono", self.path)
        assert chosen.llvm_version == (20, 1)
        assert "there is none" in chosen.reason

    def test_the_gpu_needs_no_llvm(self):
        self.gpu("GPU A")
        self.path.unlink()
        chosen = backend.choose()
        assert (chosen.variant, chosen.gpu, chosen.llvm_path) == ("cuda_ad_mono", "GPU A", None)

    def test_a_mitsuba_without_cuda(self):
        self.gpu("GPU A")
        self.patch.setattr(backend, "_compiled_in", lambda name: name == "llvm_ad_mono")
        assert backend.choose().variant == "llvm_ad_mono"

    def test_argument_over_variable_over_choice(self):
        self.gpu("GPU A")
        self.patch.setenv("SLBENCH_VARIANT", "llvm_ad_mono")
        assert backend.choose().variant == "llvm_ad_mono"
        assert backend.choose("cuda_ad_mono").variant == "cuda_ad_mono"

    @pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb", "bogus", ""])
    def test_other_variants_are_refused(self, variant):
        with pytest.raises(BackendError, match=r"^variant: expected"):
            backend.choose(variant)

    def test_cuda_on_request_without_a_gpu(self):
        with pytest.raises(BackendError, match="got none: there is none"):
            backend.choose("cuda_ad_mono")

    @pytest.mark.parametrize("first", ["pass", "import mitsuba"])
    def test_the_variants_are_known_before_and_after_the_import(self, first):
        child = run_python(
            f"{first}\nfrom slbench.simulate.render.backend import choice as backend\n"
            "names = (*backend.VARIANTS, 'bogus')\n"
            "print([backend._compiled_in(name) for name in names])\n"
        )
        assert child.stdout == "[True, True, False]\n", child.stderr

    def test_no_mitsuba(self):
        self.patch.setitem(sys.modules, "mitsuba", None)
        with pytest.raises(BackendError, match="pip install mitsuba"):
            backend.choose()


class TestActivate:
    def test_computes_with_the_llvm_it_chose(self):
        child = run_python(
            "import os\n"
            "from slbench.simulate.render import activate, current\n"
            "mi = activate()\n"
            "assert activate() is mi and activate('llvm_ad_mono') is mi\n"
            "import drjit\n"
            # The operation on which old versions abort.
            "largest = drjit.maximum(mi.Float([1, 2, 3]), mi.Float([2, 1, 5]))\n"
            "assert drjit.all(largest == mi.Float([2, 2, 5]))\n"
            "assert mi.variant() == current().variant == 'llvm_ad_mono'\n"
            "assert mi.log_level() == mi.LogLevel.Warn\n"
            "assert os.environ['DRJIT_LIBLLVM_PATH'] == str(current().llvm_path)\n"
            "maps = '/proc/self/maps'\n"
            "if os.path.exists(maps):\n"
            "    loaded = {x.split()[-1] for x in open(maps) if 'libLLVM' in x}\n"
            "    assert loaded == {os.path.realpath(current().llvm_path)}, loaded\n"
            "activate('cuda_ad_mono')\n"
        )
        assert child.returncode == 2, child.stderr
        assert "llvm_ad_mono, which this process already uses" in child.stdout

    @pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs Linux")
    def test_threads_are_those_that_the_process_may_use(self):
        child = run_python(
            "import os\n"
            "os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])\n"
            "from slbench.simulate.render import threads\n"
            "print(threads())\n"
        )
        assert (child.returncode, child.stdout) == (0, "1\n"), child.stderr

    @pytest.mark.parametrize("path", OLD_LLVM.values(), ids=lambda path: path.name)
    def test_a_real_old_llvm_does_not_abort(self, path):
        if not path.exists():
            pytest.skip("this machine has no such library")
        child = run_python(
            "from slbench.simulate.render import activate\nactivate()\n",
            DRJIT_LIBLLVM_PATH=str(path),
        )
        assert child.returncode == 2, child.stderr
        assert child.stdout.startswith("DRJIT_LIBLLVM_PATH: expected the path of an LLVM 17")
        assert child.stdout.count("\n") == 1
        assert child.stderr == ""

    @pytest.mark.parametrize(
        ("first", "major"),
        [
            ("import drjit", 14),
            ("import drjit", 15),
            # With LLVM 14 it is Mitsuba that raises here.
            ("import mitsuba; mitsuba.set_variant('llvm_ad_mono')", 15),
        ],
    )
    def test_a_real_old_llvm_loaded_before_us_does_not_abort(self, first, major):
        if not OLD_LLVM[major].exists():
            pytest.skip("this machine has no such library")
        child = run_python(
            f"{first}\nfrom slbench.simulate.render import activate\nactivate()\n",
            DRJIT_LIBLLVM_PATH=str(OLD_LLVM[major]),
        )
        assert child.returncode == 2, child.stderr
        assert "let slbench import mitsuba first" in child.stdout

    def test_no_llvm_at_all(self):
        child = run_python(
            "import slbench.simulate.render.backend.llvm as llvm\n"
            "llvm._libraries_in = lambda folders: iter(())\n"
            "from slbench.simulate.render import activate\nactivate()\n"
        )
        assert child.returncode == 2, child.stderr
        assert child.stdout.startswith("render backend: expected an LLVM 17 or newer (install it")
        assert child.stderr == ""

    def test_a_library_that_does_not_keep_what_its_name_promises(self, tmp_path):
        (tmp_path / "libLLVM-20.so").write_text("not a library")
        child = run_python(
            "from slbench.simulate.render import activate\nactivate()\n",
            DRJIT_LIBLLVM_PATH=str(tmp_path / "libLLVM-20.so"),
        )
        assert child.returncode == 2, child.stderr
        assert "got none that loads" in child.stdout

    def test_the_programs_own_variant_is_respected(self):
        path, version = llvm.find_llvm()
        child = run_python(
            "import mitsuba\nmitsuba.set_variant('llvm_ad_mono')\n"
            "from slbench.simulate.render import activate, current\n"
            "assert activate() is mitsuba\n"
            "print(current().llvm_version[0], current().llvm_path)\n",
            DRJIT_LIBLLVM_PATH=str(path),
            SLBENCH_VARIANT="",
        )
        assert (child.returncode, child.stdout) == (0, f"{version[0]} None\n"), child.stderr

    def test_the_programs_unsuitable_variant_is_refused(self):
        child = run_python(
            "import mitsuba\nmitsuba.set_variant('scalar_rgb')\n"
            "from slbench.simulate.render import activate\nactivate()\n"
        )
        assert child.returncode == 2, child.stderr
        assert "got scalar_rgb" in child.stdout
