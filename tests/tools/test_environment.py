"""The laws of tools/run and tools/test, with a stand-in for Python that only writes down what it is asked."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

SYSTEM_TOOLS = (
    *("bash", "env", "cat", "cksum", "cp", "chmod", "dirname", "flock", "grep", "head", "ls"),
    *("mkdir", "mv", "readlink", "rm", "sleep", "tail", "touch"),
)

# Called as `python -c` (is it new enough? where does it install?), `-m venv`, `-m pip` and `-m pytest`, like the real
# one.
PYTHON = """#!/usr/bin/env bash
case "$1 ${2-} ${3-}" in
'-c import os'*) cd "$(dirname "$0")/.." && pwd -P ;;
'-m venv '*)
    echo "venv" >>"$LOG"
    mkdir -p "$3/bin"
    echo "command = $0 -m venv $3" >"$3/pyvenv.cfg"
    cp "$0" "$3/bin/python" ;;
'-m pip --version') ;;
'-m pip install')
    echo "pip ${!#}${PIP_TARGET+ into $PIP_TARGET}${PIP_PYTHON+ of $PIP_PYTHON}" >>"$LOG"
    sleep "${PIP_SECONDS:-0}"
    [ ! -e "$LOG.fail" ] || exit 1
    printf '#!/usr/bin/env bash\\necho "in $PWD:"\\nprintf "<%%s>" "$@"\\nexit 7\\n' >"$(dirname "$0")/lfmesh"
    chmod +x "$(dirname "$0")/lfmesh" ;;
*/release.py*)
    printf "releases from %s:" "${1%/tools/release.py}" ;;
'-m pytest '*)
    shift 2
    echo "pytest in $PWD:"
    printf "<%s>" "$@" ;;
esac
"""


class Machine:
    """A checkout in a folder with a space in its name, on a machine with nothing but the given commands."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "a check out"
        self.elsewhere = folder / "else where"
        self.bin = folder / "bin"
        self.log = folder / "log"
        shutil.copytree(ROOT / "tools", self.root / "tools", ignore=shutil.ignore_patterns("__pycache__"))
        (self.root / "pyproject.toml").write_text("[project]\n")
        self.elsewhere.mkdir()
        self.bin.mkdir()
        self.log.touch()
        for name in SYSTEM_TOOLS:
            if found := shutil.which(name):
                (self.bin / name).symlink_to(found)
        self.command("python3.12", PYTHON)
        self.command("uname", "echo Linux")
        self.command("id", "echo 1000")
        self.command("dpkg-query", "printf 'install ok installed'")
        self.command("apt-get", 'echo "apt-get $*" >>"$LOG"')

    def command(self, name: str, script: str) -> None:
        path = self.bin / name
        path.write_text(script if script.startswith("#!") else f"#!/usr/bin/env bash\n{script}\n")
        path.chmod(0o755)

    def start(self, tool: str, *arguments: str, **variables: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [self.root / "tools" / tool, *arguments],
            cwd=self.elsewhere,
            env={"PATH": str(self.bin), "LOG": str(self.log), **variables},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, tool: str, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
        process = self.start(tool, *arguments, **variables)
        out, err = process.communicate(timeout=60)
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    @property
    def done(self) -> list[str]:
        return self.log.read_text().splitlines()


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    if os.name != "posix":
        pytest.skip("the tools are shell scripts")
    return Machine(tmp_path)


def test_arguments_folder_and_exit_code_pass_through(machine: Machine) -> None:
    result = machine.run("run", "render", "my scene.toml", "")
    assert result.returncode == 7
    assert result.stdout == f"in {machine.elsewhere}:\n<render><my scene.toml><>"


def test_only_the_command_writes_to_standard_output(machine: Machine) -> None:
    result = machine.run("run", "schema")
    assert "making .venv" in result.stderr
    assert "lfmesh:" not in result.stdout


def test_environment_is_made_once_and_reused(machine: Machine) -> None:
    machine.run("run")
    second = machine.run("run")
    assert machine.done == ["venv", "pip .[browser]"]
    assert second.stderr == ""


def test_a_changed_pyproject_installs_again_into_the_same_environment(machine: Machine) -> None:
    machine.run("run")
    (machine.root / "pyproject.toml").write_text('[project]\nname = "other"\n')
    machine.run("run")
    machine.run("run")
    assert machine.done == ["venv", "pip .[browser]", "pip .[browser]"]


def test_the_development_tools_are_added_once_and_kept(machine: Machine) -> None:
    machine.run("run")
    machine.run("test")
    machine.run("run")
    (machine.root / "pyproject.toml").write_text('[project]\nname = "other"\n')
    machine.run("run")
    machine.run("test")
    assert machine.done == ["venv", "pip .[browser]", "pip .[dev]", "pip .[dev]"]


def test_long_tests_add_the_programs_that_they_compare_with_and_these_stay(machine: Machine) -> None:
    machine.run("test")
    machine.run("test", "-k", "a", "--long")
    machine.run("test")
    machine.run("run")
    (machine.root / "pyproject.toml").write_text('[project]\nname = "other"\n')
    machine.run("test")
    assert machine.done == ["venv", "pip .[dev]", "pip .[dev,docs,long]", "pip .[dev,docs,long]"]


def test_the_site_is_built_with_its_own_extra_beside_the_development_tools(machine: Machine) -> None:
    machine.run("test")
    machine.run("docs")
    machine.run("test")
    machine.run("docs")
    assert machine.done == ["venv", "pip .[dev]", "pip .[dev,docs]"]


def test_a_release_without_dry_run_is_refused_before_anything_is_installed(machine: Machine) -> None:
    result = machine.run("release")
    assert result.returncode == 2
    assert "publishes nothing" in result.stderr
    assert machine.done == []


def test_a_dry_run_of_a_release_needs_no_environment_of_the_project(machine: Machine) -> None:
    result = machine.run("release", "--dry-run")
    assert (result.returncode, result.stdout) == (0, f"releases from {machine.root}:")
    assert machine.done == []
    assert not (machine.root / ".venv").exists()


def test_tests_run_in_the_project_folder(machine: Machine) -> None:
    result = machine.run("test", "--long", "-k", "a or b")
    assert result.stdout == f"pytest in {machine.root}:\n<--numprocesses=2><--dist=loadfile><--long><-k><a or b>"


def test_a_failed_installation_is_done_again(machine: Machine) -> None:
    failure = machine.log.with_name("log.fail")
    failure.touch()
    broken = machine.run("run")
    assert broken.returncode == 1
    assert "installation failed" in broken.stderr
    failure.unlink()
    assert machine.run("run").returncode == 7
    assert machine.done == ["venv", "pip .[browser]", "pip .[browser]"]


def test_a_killed_installation_is_done_again(machine: Machine) -> None:
    killed = machine.start("run", PIP_SECONDS="1")
    while "pip .[browser]" not in machine.done:
        assert killed.poll() is None, "ended before it installed"
    killed.kill()
    killed.communicate(timeout=60)
    assert machine.run("run").returncode == 7
    assert machine.done == ["venv", "pip .[browser]", "pip .[browser]"]


@pytest.mark.skipif(shutil.which("flock") is None, reason="without flock the tools do not lock")
def test_two_commands_at_once_install_once(machine: Machine) -> None:
    both = [machine.start("run", PIP_SECONDS="1") for _ in range(2)]
    said = [process.communicate(timeout=60)[1] for process in both]
    assert [process.returncode for process in both] == [7, 7]
    assert machine.done == ["venv", "pip .[browser]"]
    assert sum("waiting for another command" in text for text in said) == 1


def test_a_moved_checkout_gets_an_environment_of_its_own(machine: Machine) -> None:
    machine.run("run")
    machine.root = machine.root.rename(machine.root.with_name("moved"))
    machine.run("run")
    machine.run("run")
    assert machine.done == ["venv", "pip .[browser]", "venv", "pip .[browser]"]


@pytest.mark.parametrize("kept", ["lfmesh-installed", "pyvenv.cfg"])
def test_a_copied_environment_is_not_used(machine: Machine, kept: str) -> None:
    """Either record of the original's folder is enough: an installation that was killed leaves no stamp."""
    machine.run("test")
    original = machine.root
    machine.root = Path(shutil.copytree(original, original.with_name("copy"), symlinks=True))
    for name in {"lfmesh-installed", "pyvenv.cfg"} - {kept}:
        (machine.root / ".venv" / name).unlink()
    (machine.root / ".venv" / "of the original").touch()
    before = {path: path.stat().st_mtime_ns for path in original.rglob("*")}
    machine.run("test")
    assert machine.done == ["venv", "pip .[dev]", "venv", "pip .[dev]"]
    assert not (machine.root / ".venv" / "of the original").exists()
    assert {path: path.stat().st_mtime_ns for path in original.rglob("*")} == before


@pytest.mark.parametrize("options", ["", '--copies --prompt="a /b" '])
def test_an_environment_that_the_user_made_is_used(machine: Machine, options: str) -> None:
    home = machine.root / ".venv"
    (home / "bin").mkdir(parents=True)
    (home / "pyvenv.cfg").write_text(f"command = /usr/bin/python3 -m venv {options}{home}")
    shutil.copy(machine.bin / "python3.12", home / "bin" / "python")
    machine.run("run")
    assert machine.done == ["pip .[browser]"]


def test_nothing_is_installed_through_a_link_to_another_environment(machine: Machine) -> None:
    machine.run("run")
    original = machine.root / ".venv"
    machine.root = Path(shutil.copytree(machine.root, machine.root.with_name("other"), ignore=lambda *_: [".venv"]))
    (machine.root / ".venv").symlink_to(original)
    result = machine.run("test")
    assert result.returncode == 1
    assert f".venv is a link to {original}" in result.stderr
    assert machine.done == ["venv", "pip .[browser]"]
    assert (original / "lfmesh-installed").is_file()


def test_a_python_that_leads_into_another_environment_is_replaced(machine: Machine) -> None:
    machine.run("run")
    machine.command("foreign", PYTHON.replace('cd "$(dirname "$0")/.." && pwd -P', "echo /another/.venv"))
    python = machine.root / ".venv" / "bin" / "python"
    python.unlink()
    python.symlink_to(machine.bin / "foreign")
    machine.run("test")
    assert machine.done == ["venv", "pip .[browser]", "venv", "pip .[dev]"]
    assert not python.is_symlink()


def test_settings_of_the_shell_do_not_send_an_installation_elsewhere(machine: Machine) -> None:
    machine.run("run", PIP_TARGET="/elsewhere", PIP_PYTHON="/elsewhere/bin/python")
    assert machine.done == ["venv", "pip .[browser]"]


@pytest.mark.parametrize(
    ("script", "said"),
    [("exit 1", "needs Python 3.11 or newer"), ('[[ "$*" != *ensurepip* ]]', "python3.12-venv")],
    ids=["too old", "without venv"],
)
def test_an_unfit_python_is_named(machine: Machine, script: str, said: str) -> None:
    machine.command("python3.12", script)
    result = machine.run("run")
    assert result.returncode == 1
    assert said in result.stderr
    assert not (machine.root / ".venv").exists()


def test_an_older_python_is_passed_over(machine: Machine) -> None:
    machine.command("python3.13", "exit 127")
    assert machine.run("run").returncode == 7


@pytest.mark.parametrize("named", ["python3.11", "a folder/python3.11"])
def test_another_python_has_an_environment_of_its_own(machine: Machine, named: str) -> None:
    (machine.bin / "a folder").mkdir()
    for name in ("python3.11", "a folder/python3.11"):
        machine.command(name, PYTHON)
    path = named if "/" not in named else str(machine.bin / named)
    machine.run("run")
    other = machine.run("test", LFMESH_PYTHON=path)
    machine.run("run")
    machine.run("test", LFMESH_PYTHON=path)
    assert "making .venv-python3.11 with" in other.stderr
    assert "pytest in" in other.stdout
    assert machine.done == ["venv", "pip .[browser]", "venv", "pip .[dev]"]
    assert all((machine.root / each / "bin" / "python").exists() for each in (".venv", ".venv-python3.11"))


def test_no_other_python_stands_in_for_the_one_that_is_named(machine: Machine) -> None:
    result = machine.run("test", LFMESH_PYTHON="python3.14")
    assert result.returncode == 1
    assert "looked for python3.14." in result.stderr
    assert machine.done == []


def test_missing_drawing_libraries_are_installed_for_root(machine: Machine) -> None:
    machine.command("dpkg-query", '[ "${!#}" != libegl1 ] && printf "install ok installed"')
    machine.command("id", "echo 0")
    assert machine.run("run").returncode == 7
    assert [line.split()[2] for line in machine.done if line.startswith("apt-get")] == ["update", "install"]
    (installed,) = [line for line in machine.done if " install " in line]
    assert installed.split()[-1] == "libegl1", "only what is missing"


def test_chromium_is_installed_for_the_tests_alone(machine: Machine) -> None:
    machine.command("dpkg-query", '[ "${!#}" != chromium ] && printf "install ok installed"')
    machine.command("id", "echo 0")
    machine.run("run")
    assert not [line for line in machine.done if line.startswith("apt-get")]
    machine.run("test")
    assert [line.split()[-1] for line in machine.done if " install " in line] == ["chromium"]


def test_missing_drawing_libraries_are_named_to_a_user(machine: Machine) -> None:
    machine.command("dpkg-query", "exit 1")
    result = machine.run("run")
    assert result.returncode == 7
    assert "sudo apt-get install libegl1 libgl1-mesa-dri" in result.stderr
    assert machine.done == ["venv", "pip .[browser]"]


def test_a_failing_apt_get_stops_nothing(machine: Machine) -> None:
    machine.command("dpkg-query", "exit 1")
    machine.command("id", "echo 0")
    machine.command("apt-get", "exit 100")
    result = machine.run("run")
    assert result.returncode == 7
    assert "everything but drawing works" in result.stderr
