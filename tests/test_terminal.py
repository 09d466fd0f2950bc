"""The terminal: quiet and verbose commands, completion, Ctrl-C, names that would send escapes."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest

import sweep_signals
from command_line import run_command
from grid_maps import level_from
from navbake.cli.main import COMMANDS
from navbake.cli.printing import LOG, print_error, say, say_unless_quiet, use_verbosity
from navbake.navgrid.rooms import Room
from project_paths import ROOT

ESCAPE = "\x1b[31mred"


@pytest.fixture
def grid(tmp_path, monkeypatch):
    """The current folder, with the grid of a level whose scene and object have escape codes."""
    monkeypatch.chdir(tmp_path)
    level = level_from("......\n..##..\n......")
    level.user_data = {8: {"objects": [ESCAPE]}, 9: {"objects": [ESCAPE]}}
    level.metadata["sceneId"] = ESCAPE
    level.save("a.grid.json")
    return tmp_path / "a.grid.json"


@pytest.fixture
def run(capsys):
    return partial(run_command, capsys)


def test_all_commands_take_quiet_and_verbose(run):
    for command in (command for group in COMMANDS.values() for command in group):
        _, out, _ = run(command.__name__.replace("_", "-"), "--help")
        assert "-q, --quiet" in out and "-v, --verbose" in out


def test_quiet_prints_nothing_but_what_was_asked_for(grid, run):
    assert run("inflate", grid, "--radius", "0.1", "-o", "b.json", "-q") == (0, "", "")
    assert run("plot", grid, "-o", "b.png", "-q") == (0, "", "")
    assert run("info", grid, "-q")[1] == run("info", grid)[1] != ""
    assert run("info", "none.json", "-q")[2].startswith("navbake: ")


def test_verbose_says_what_is_read_and_written_on_stderr(grid, run):
    status, out, err = run("inflate", grid, "--radius", "0.1", "-o", "b.json", "-v")
    assert status == 0
    assert out == run("inflate", grid, "--radius", "0.1", "-o", "b.json")[1]
    assert f"navbake: reading {grid}\n" in err
    assert "navbake: wrote b.json, " in err
    assert "s in all\n" in err


def test_verbose_says_what_led_to_an_error(grid, run):
    assert "because of" not in run("info", "none.json")[2]
    assert "because of FileNotFoundError" in run("info", "none.json", "-v")[2]


def test_quiet_and_verbose_at_once_are_refused(grid, run):
    status, _, err = run("info", grid, "-q", "-v")
    assert status == 2 and "--quiet, --verbose" in err


@pytest.mark.parametrize(
    "arguments",
    [
        ["info"],
        ["info", "--json"],
        ["rooms", "--json"],
        ["why", "--at", "0.25,-0.15"],
        ["why", "--at", "0.25,-0.15", "--json"],
        ["path", "--from", "0.05,-0.05", "--to", "object:x"],
        ["path", "--from", "0.05,-0.05", "--to", f"object:{ESCAPE}"],
        ["info", "-v"],
    ],
)
def test_escape_codes_in_names_are_shown_not_sent(grid, run, arguments):
    _, out, err = run(arguments[0], grid, *arguments[1:])
    assert "\x1b" not in out + err
    if arguments[:1] != ["rooms"]:
        assert "x1b[31m" in out + err or "u001b[31m" in out + err or arguments[0] == "path"
    if "--json" in arguments:
        json.loads(out)


@pytest.mark.parametrize("name", ["\x1b[2Jroom", "room\x9b31m", "a\rb", "\u202eroom"])
def test_lines_that_are_said_control_no_terminal(capsys, name):
    say(name)
    say_unless_quiet(name)
    print_error(name)
    level = LOG.level
    with use_verbosity(quiet=False, verbose=True):
        LOG.debug(name)
    assert LOG.level == level
    printed = capsys.readouterr()
    assert name not in printed.out + printed.err
    assert (printed.out + printed.err).replace("\n", "").isprintable()
    assert len(printed.out.splitlines()) == 2
    assert len(printed.err.splitlines()) == 3  # the last one says how long it took


def test_verbose_is_over_with_its_command_and_says_no_warning_twice(capsys):
    before = LOG.level, list(LOG.handlers)
    with use_verbosity(quiet=False, verbose=True):
        LOG.debug("read")
        LOG.warning("a warning, which the command prints itself")
    assert (LOG.level, LOG.handlers) == before
    printed = capsys.readouterr().err
    assert "read" in printed and "a warning" not in printed


def test_characters_beyond_ascii_control_no_terminal_in_json(capsys):
    from navbake.cli.printing import print_json

    value = {"name": "\x9b31mred é 厨房 \U000e0001"}
    print_json(value)
    out = capsys.readouterr().out
    assert "\x9b" not in out and "é 厨房" in out
    assert json.loads(out) == value


# ---------------------------------------------------------------- completion


def complete(typed, folder, *options):
    """What bash gets for the last of the words that were typed, and stderr."""
    env = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "_NAVBAKE_COMPLETE": "complete_bash",
        "COMP_WORDS": typed,
        "COMP_CWORD": str(len(typed.split(" ")) - 1),
    }
    command = [sys.executable, *options, "-m", "navbake"]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False, cwd=folder)
    return done.stdout.split(), done.stderr


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("navbake ro", ["rooms", "routes"]),
        ("navbake bake --isolate-", ["--isolate-seconds", "--isolate-memory"]),
        ("navbake samples h", ["house"]),
        ("navbake bake --set a=1 to", ["tower", "town.grid.json"]),
        ("navbake path --by ", ["cost", "time"]),
        ("navbake path town.grid.json --doors o", ["open"]),
        ("navbake episodes --task s", ["sequence"]),
        ("navbake plot town.grid.json --layer f", ["floor"]),
        ("navbake plot town.grid.json --level ", ["0", "street"]),
        ("navbake sample town.grid.json --level s", ["street"]),
        (
            "navbake convert town.grid.json a --to nav2",
            ["nav2", "nav2-keepout", "nav2-speed", "nav2-route"],
        ),
        ("navbake sample town.grid.json --room h", ["hall"]),
        ("navbake path town.grid.json --to object:", ["object:bed"]),
        ("navbake episodes town.grid.json --object b", ["bed"]),
        ("navbake sample none.grid.json --room ", []),
        ("navbake sample broken.json --room ", []),
    ],
)
def test_a_shell_completes_commands_options_and_values(tmp_path, typed, expected):
    level = level_from("......\n..##..\n......")
    level.user_data = {8: {"objects": ["bed"]}}
    level.attributes["roomIndex"] = np.ones(level.shape, dtype=np.uint16)
    hall = Room(1, "0:1", "hall", 0, 0.18, (0.3, -0.2, 0.0), "auto")
    level.metadata["navbake"] = {"rooms": [hall.to_json()], "levels": [{"name": "street"}]}
    level.save(tmp_path / "town.grid.json")
    (tmp_path / "broken.json").write_text("{")
    assert complete(typed, tmp_path)[0] == expected


def test_completion_of_words_loads_no_numpy(tmp_path):
    words, loaded = complete("navbake path --by c", tmp_path, "-X", "importtime")
    assert words == ["cost"]
    assert "numpy" not in loaded and "navbake.cli.completion" in loaded


def test_completion_can_be_installed(run):
    _, out, _ = run("--help")
    assert "--install-completion" in out and "--show-completion" in out


# ---------------------------------------------------------------- Ctrl-C

# Says when it is ready: before that, while Python itself starts, Ctrl-C is not navbake's.
STARTED = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests may run in the background
from navbake import __main__ as start
set_handler = signal.signal
def tell(*arguments):
    set_handler(*arguments)
    print("ready", flush=True)
signal.signal = tell
start.main()
"""


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX")
@pytest.mark.parametrize("delay", [0.0, 0.03, 0.1, 0.3, 0.6, 1.0, 1.5])
def test_ctrl_c_is_clean_at_any_time(tmp_path, delay):
    """During the imports of the command line, of MuJoCo, of numba, and during the bake itself."""
    command = [sys.executable, "-c", STARTED, "bake", str(ROOT / "configs" / "house.yaml")]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        time.sleep(delay)
        child.send_signal(signal.SIGINT)
        _, err = child.communicate(timeout=60)
    assert "Traceback" not in err and "KeyboardInterrupt" not in err
    assert child.returncode in (130, 0)  # 0: it was done before
    assert delay > 0.3 or child.returncode == 130


RAISED = "signal.raise_signal(signal.SIGINT)"
LIBRARY = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests may run in the background
from navbake import __main__ as start
import navbake.cli.main as command_line
def run():
    try:
        signal.raise_signal(signal.SIGINT)
    except SystemExit as error:
        {body}
command_line.main = run
start.main()
"""


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX")
def test_libraries_that_turn_ctrl_c_into_an_error_change_nothing():
    body = "raise ImportError('a library was interrupted') from error"
    done = subprocess.run(
        [sys.executable, "-c", LIBRARY.format(body=body)], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (130, "")


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX")
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_code_in_c_is_ended_too(number, status):
    """While MuJoCo compiles, no Python runs on the main thread."""
    code = """
import hashlib, signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from navbake import __main__ as start
import navbake.cli.main as command_line
start.SIGNAL_TIMEOUT = 0.3
def run():
    print("ready", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2_000_000_000)
command_line.main = run
start.main()
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        child.send_signal(number)
        try:
            assert child.wait(20) == status
        finally:
            child.kill()


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX")
def test_ctrl_c_within_exec_has_its_status(tmp_path):
    """A KeyboardInterrupt there would make ``python -m`` end by the signal."""
    code = LIBRARY.format(body="raise")
    in_exec = code.replace(RAISED, f'exec("{RAISED}")')
    (tmp_path / "command.py").write_text(in_exec)
    done = subprocess.run([sys.executable, "-m", "command"], cwd=tmp_path, capture_output=True)
    assert (done.returncode, done.stderr) == (130, b"")


def test_bugs_are_no_ctrl_c():
    body = "raise SystemExit(0)"
    done = subprocess.run(
        [sys.executable, "-c", LIBRARY.format(body=body)], capture_output=True, text=True
    )
    assert done.returncode == 0
    code = LIBRARY.replace(RAISED, "1 / 0").format(body="pass")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1 and "ZeroDivisionError" in done.stderr


TIDY = """
import signal, time
from navbake import __main__ as start
import navbake.cli.main as command_line
def run():
    try:
        {begin}
        time.sleep(20)
    finally:
        {meanwhile}
        time.sleep(0.3)
        print("tidy")
command_line.main = run
start.main()
"""
ANOTHER = "signal.raise_signal(signal.SIGTERM)"


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX")
@pytest.mark.parametrize("meanwhile", [ANOTHER, f"[{ANOTHER} for _ in range(3)]"])
def test_what_tidies_up_after_a_sigterm_is_not_ended_by_another(meanwhile):
    code = TIDY.format(begin=ANOTHER, meanwhile=meanwhile)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (143, "tidy\n", "")


# ---------------------------------------------------------------- what would never end

STARTING_THREAD = """
import os, signal, sys, threading
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests may run in the background
number = int(sys.argv.pop(1))
start_thread = threading.Thread.start
signalled = []
def start_and_signal(thread):
    start_thread(thread)
    if thread.name.startswith("navbake") and not signalled:
        signalled.append(thread)
        print("ready", flush=True)
        os.kill(os.getpid(), number)
threading.Thread.start = start_and_signal
from navbake.__main__ import main
main()
"""
HANGING = """
import atexit, signal, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from navbake import __main__ as start
import navbake.cli.main as command_line
start.SIGNAL_TIMEOUT = {timeout}
def wait():
    print("ready", flush=True)
    threading.Event().wait()
def run():
    {body}
command_line.main = run
start.main()
"""
BODIES = {
    "a library catches the exception": """
    while True:
        try:
            wait()
        except BaseException:
            pass""",
    "Python waits for a thread": """
    threading.Thread(target=threading.Event().wait).start()
    wait()""",
    "what is called at the end hangs": "atexit.register(wait)",
}


def status_at_end(child, number=None):
    """The exit status of a process, which ends after it said that it is ready.

    Args:
        child: the process.
        number: the signal that it gets when it is ready; None if it sends one to itself.
    """
    try:
        assert child.stdout.readline() == "ready\n"
        if number is not None:
            child.send_signal(number)
        return child.wait(20)
    finally:
        child.kill()


both_signals = pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)]
)


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX")
@both_signals
def test_a_signal_while_a_thread_starts_ends_the_bake(tmp_path, number, status):
    house = str(ROOT / "configs" / "house.yaml")
    command = [sys.executable, "-c", STARTING_THREAD, str(int(number)), "bake", house]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as child:
        assert status_at_end(child) == status
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX")
@both_signals
@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_what_would_never_end_is_ended(number, status, body):
    code = HANGING.format(timeout=0.3, body=body)
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert status_at_end(child, number) == status


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX")
@both_signals
@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_another_ctrl_c_ends_at_once(number, status, body):
    code = HANGING.format(timeout=300.0, body=body)
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        child.send_signal(number)
        time.sleep(0.5)
        assert child.poll() is None
        child.send_signal(signal.SIGINT)
        try:
            assert child.wait(30) == status
        finally:
            child.kill()


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_after_the_command_has_ended_changes_nothing(number):
    body = f"atexit.register(signal.raise_signal, {int(number)})"
    code = HANGING.format(timeout=300.0, body=body)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(sys.platform != "linux", reason="the sweep reads /proc")
@pytest.mark.parametrize(("name", "count"), [("bake", 2), ("convert", 1), ("batch", 2)])
def test_signals_at_random_moments(name, count, tmp_path, monkeypatch):
    """The sweep itself says how fast commands end, on a machine that does nothing else."""
    monkeypatch.setattr(sweep_signals, "MAX_SECONDS", sweep_signals.PATIENCE)
    part, old_folder = sweep_signals.make_part(tmp_path, name)
    assert sweep_signals.sweep(name, part, old_folder, count, random.Random(0))
