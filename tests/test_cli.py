"""The command line: options, exit codes, what is printed where, and how fast it starts."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
import types
from pathlib import Path

import pytest

from usdskin import __version__, cli, plugin_path
from usdskin.errors import DeviceError, FindingsError, FramesError, LayerError
from usdskin.notes import Note
from usdskin.progress import JsonProgress, PlainProgress, TerminalProgress, format_rate

HEAVY = (
    "pxr",
    "warp",
    "numpy",
    "colour",
    "scipy",
    "open3d",
    "rich",
    "OpenImageIO",
    "OpenEXR",
    "PyOpenColorIO",
)


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "usdskin", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture
def step(monkeypatch):
    """Replace the render step; ``calls`` keeps what it was given, ``does`` is what it does."""
    module = types.ModuleType("usdskin.render.render")
    record = types.SimpleNamespace(
        calls=[],
        does=lambda: None,
        report=types.SimpleNamespace(paths=[Path("a.exr")], notes=[], seconds={}, failures={}),
    )

    def render_stage(stage, output, overrides, progress):
        record.calls.append((stage, output, overrides, progress))
        record.does()
        return record.report

    module.render_stage = render_stage
    monkeypatch.setitem(sys.modules, "usdskin.render.render", module)
    return record


def overrides_of(step, *arguments):
    assert cli.main(["render", "shot.usda", *arguments]) == 0
    return step.calls[-1][2]


# Ending


@pytest.mark.parametrize(
    ("arguments", "code"), [(["--version"], 0), (["render", "none.usda"], 3), (["no"], 2)]
)
def test_a_process_ends_with_the_code_of_its_command(arguments, code):
    """The whole of what it says arrives, though nothing is freed at its end."""
    told = subprocess.run(
        [sys.executable, "-m", "usdskin", *arguments], capture_output=True, text=True, check=False
    )
    assert told.returncode == code
    assert (told.stdout if code == 0 else told.stderr).startswith("usdskin")


def test_others_are_told_of_the_end_of_a_process(tmp_path):
    script = (
        "import atexit, pathlib, sys; from usdskin import cli; "
        "sys.argv = ['usdskin', '--version']; "
        "old = cli.main; "
        "cli.main = lambda **_: [old(), atexit.register(pathlib.Path('told').touch)][0]; "
        "cli.run()"
    )
    subprocess.run([sys.executable, "-c", script], check=True, cwd=tmp_path)
    assert (tmp_path / "told").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_no_room_for_what_is_printed_is_one_line():
    with open("/dev/full", "w") as full:
        told = subprocess.run(
            [sys.executable, "-m", "usdskin", "--help"],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert told.returncode == 3
    assert told.stderr == "usdskin: error: No space left on device; free some space.\n"


# Starting


@pytest.mark.parametrize(
    "arguments", [["--help"], ["render", "--help"], ["--version"], ["schema-path"], ["nothing"]]
)
def test_what_needs_no_step_loads_nothing_heavy(arguments):
    script = (
        "import sys; from usdskin.cli import main; main(sys.argv[1:]); "
        "loaded = {name.partition('.')[0] for name in sys.modules}; "
        f"print(sorted(loaded & {set(HEAVY)!r}), file=sys.stderr)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True
    )
    assert ran.stderr.splitlines()[-1] == "[]"


def test_python_m_usdskin_prints_its_version():
    ran = run("--version")
    assert (ran.returncode, ran.stdout) == (0, f"usdskin {__version__}\n")


def test_no_command_shows_the_help(capsys):
    assert cli.main([]) == 0
    assert "Commands:" in capsys.readouterr().out


@pytest.mark.parametrize("group", ["calibrate", "estimate"])
def test_a_group_without_a_command_shows_its_help(group, capsys):
    assert cli.main([group]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert shown.out.startswith(f"Usage: usdskin {group} ")
    assert "\nCommands:\n" in shown.out


@pytest.mark.parametrize("name", sorted(cli.cli.commands))
def test_every_command_has_help_with_an_example(name, capsys):
    assert cli.main([name, "--help"]) == 0
    shown = capsys.readouterr().out
    assert "Example" in shown
    assert f"usdskin {name}" in shown or f"usdskin --json {name}" in shown
    assert "\\b" not in shown


def test_schema_path_is_a_folder_with_the_plugin(capsys):
    assert cli.main(["schema-path"]) == 0
    shown = capsys.readouterr().out.strip()
    assert shown == plugin_path()
    assert (Path(shown) / "plugInfo.json").is_file()


# Options of render


def test_flags_that_were_not_given_say_nothing(step):
    overrides = overrides_of(step)
    assert step.calls[0][:2] == (Path("shot.usda"), None)
    given = {name: getattr(overrides, name) for name in overrides.__dataclass_fields__}
    said = {name for name, value in given.items() if value not in (None, False, ())}
    assert said == {"device"}
    assert overrides.device == "auto"


def test_single_dash_names_work_as_typed(step):
    overrides = overrides_of(
        step,
        "o.exr",
        "-cam",
        "/Cam",
        "-rs",
        "/Render/Main",
        "-r",
        "64",
        "48",
        "-p",
        "16",
        "-w",
        "9",
    )
    assert step.calls[-1][1] == Path("o.exr")
    assert (overrides.camera, overrides.settings) == ("/Cam", "/Render/Main")
    assert (overrides.resolution, overrides.width) == ((64, 48), 9)
    assert overrides.samples == 16


def test_range_that_begins_with_a_minus_is_a_range(step):
    assert overrides_of(step, "-f", "-5--3").frames == (-5, -4, -3)


@pytest.mark.parametrize(
    ("arguments", "output", "spectral", "method"),
    [
        ([], None, None, None),
        (["--spectral"], None, True, "factorised"),
        (["--spectral", "o.exr"], "o.exr", True, "factorised"),
        (["--spectral", "brute", "o.exr"], "o.exr", True, "brute"),
        (["o.exr", "--spectral=brute"], "o.exr", True, "brute"),
        (["o.exr", "--spectral", "-p", "4"], "o.exr", True, "factorised"),
        (["--no-spectral", "o.exr"], "o.exr", False, None),
    ],
)
def test_spectral_stands_alone_or_takes_a_method(step, arguments, output, spectral, method):
    overrides = overrides_of(step, *arguments)
    assert step.calls[-1][1] == (None if output is None else Path(output))
    assert (overrides.spectral_output, overrides.spectral_method) == (spectral, method)


def test_repeated_and_listed_options_arrive_in_order(step):
    overrides = overrides_of(
        step,
        *("--set", "/A.b=1", "--set", "/A.c=x=y", "--variant", "/A{v=w}"),
        *("--mask", "/A, /B", "--purposes", "default,proxy", "--aov", "N,Z"),
    )
    assert overrides.attributes == ("/A.b=1", "/A.c=x=y")
    assert overrides.variants == ("/A{v=w}",)
    assert overrides.mask == ("/A", "/B")
    assert overrides.purposes == ("default", "proxy")
    assert overrides.aovs == ("N", "Z")


def test_complexity_names_subdivision_levels(step):
    assert overrides_of(step, "--complexity", "high").subdivision_level == 2
    assert overrides_of(step, "--level", "4").subdivision_level == 4


def test_display_and_light_options_arrive(step):
    overrides = overrides_of(
        step,
        *("--ev", "-1.5", "--white", "D50", "--view", "ACES", "--illuminant", "FL11"),
        *("--bad-pixels", "clamp", "--dome", "show", "--no-png", "--half", "--skip-existing"),
        *("--wavelengths", "400:700:10", "--filter", "box", "--seed", "7", "--compression", "piz"),
    )
    assert (overrides.ev, overrides.white, overrides.view) == (-1.5, "D50", "ACES")
    assert (overrides.illuminant, overrides.bad_pixels) == ("FL11", "clamp")
    assert (overrides.dome, overrides.png, overrides.half) == ("show", False, True)
    assert (overrides.skip_existing, overrides.wavelength_nm.size) == (True, 31)
    assert (overrides.pixel_filter, overrides.seed, overrides.compression) == ("box", 7, "piz")
    assert overrides_of(step, "--ev", "auto").ev == "auto"


def test_global_options_work_before_and_after_the_command(step):
    assert cli.main(["--threads", "3", "--device", "cuda", "render", "shot.usda"]) == 0
    assert (step.calls[-1][2].threads, step.calls[-1][2].device) == (3, "cuda:0")
    assert overrides_of(step, "--threads", "2", "--device", "cpu").threads == 2


@pytest.mark.parametrize(
    "arguments",
    [
        ["--nothing"],
        ["nothing"],
        ["render"],
        ["render", "a", "b", "c"],
        ["render", "a", "-r", "64"],
        ["render", "a", "-f", "1-"],
        ["render", "a", "--ev", "bright"],
        ["render", "a", "--ev", "nan"],
        ["render", "a", "--aov", "N,,Z"],
        ["render", "a", "--wavelengths", "400-700"],
        ["render", "a", "--spectral", "--no-spectral"],
        ["render", "a", "--complexity", "low", "--level", "1"],
        ["--device", "gpu", "render", "a"],
        ["--threads", "0", "render", "a"],
        ["-v", "-q", "render", "a"],
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(step, arguments, capsys):
    assert cli.main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert printed.err.startswith("usdskin: error: ")
    assert not step.calls


# What is printed


def test_paths_go_to_stdout_and_notes_to_stderr(step, capsys):
    step.report.notes.append(Note("fog-ignored", "/Fog", "there is fog"))
    assert cli.main(["render", "shot.usda"]) == 0
    printed = capsys.readouterr()
    assert printed.out == "a.exr\n"
    assert printed.err == "usdskin: note: fog-ignored </Fog>: there is fog\n"


def test_seconds_are_told_when_verbose(step, capsys):
    step.report.seconds["shade"] = 1.25
    assert cli.main(["-v", "render", "shot.usda"]) == 0
    assert "usdskin: shade: 1.250 s" in capsys.readouterr().err


def test_json_is_one_object_a_line(step, capsys):
    step.report.notes.append(Note("fog-ignored", "/Fog", "there is fog"))
    step.report.seconds["shade"] = float("inf")

    def work():
        progress = step.calls[-1][3]
        progress.start(4, "shade")
        progress.advance(4)
        progress.done()

    step.does = work
    assert cli.main(["render", "shot.usda", "--json"]) == 0
    printed = capsys.readouterr()
    events = [json.loads(line) for line in printed.out.splitlines()]
    assert [event["event"] for event in events] == ["progress", "note", "seconds", "wrote"]
    assert events[0]["total"] == 4
    assert events[2]["shade"] is None
    assert events[3]["path"] == "a.exr"
    assert printed.err == ""


# Exit codes


def failing(error):
    def fail():
        raise error

    return fail


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (LayerError("a.usda </A>: it\n is wrong"), 3),
        (FindingsError("x"), 4),
        (FramesError("x"), 5),
        (DeviceError("x"), 6),
        (MemoryError(), 6),
        (PermissionError(13, "Permission denied", "/root/a.exr"), 3),
        (KeyboardInterrupt(), 130),
    ],
)
def test_error_is_one_line_and_its_exit_code(step, error, code, capsys):
    step.does = failing(error)
    assert cli.main(["render", "shot.usda"]) == code
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("usdskin: error: ")
    assert printed.err.count("\n") == 1


def test_error_is_an_event_with_json(step, capsys):
    step.does = failing(LayerError("a.usda </A>: it\n is wrong"))
    assert cli.main(["--json", "render", "shot.usda"]) == 3
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line) == {
        "event": "error",
        "kind": "LayerError",
        "message": "a.usda </A>: it is wrong",
        "exit_code": 3,
    }


@pytest.mark.parametrize("error", [ValueError("oops"), EOFError("oops"), FileNotFoundError("oops")])
def test_bug_keeps_its_traceback_and_exits_with_1(step, error, capsys):
    step.does = failing(error)
    assert cli.main(["render", "shot.usda"]) == 1
    printed = capsys.readouterr().err
    assert printed.startswith("Traceback")
    assert "oops" in printed


def test_failed_frames_are_told_after_the_files_of_the_others(step, capsys):
    step.report.failures = {"7": "x.usda </A>: it is wrong"}
    assert cli.main(["render", "shot.usda"]) == 5
    printed = capsys.readouterr()
    assert printed.out == "a.exr\n"
    assert "7" in printed.err
    assert "it is wrong" in printed.err


def test_sigterm_exits_with_143_and_gives_the_signal_back(step, capsys):
    before = signal.getsignal(signal.SIGTERM)

    def work():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(10)

    step.does = work
    assert cli.main(["render", "shot.usda"]) == 143
    assert signal.getsignal(signal.SIGTERM) is before


def test_sigint_exits_with_130(step):
    # A job in the background of a shell starts with SIGINT ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)

    def work():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(10)

    step.does = work
    try:
        assert cli.main(["render", "shot.usda"]) == 130
    finally:
        signal.signal(signal.SIGINT, before)


def lost_in_an_import(tmp_path, monkeypatch):
    """Make a module whose import swallows an interrupt, as extensions do."""
    (tmp_path / "swallows.py").write_text(
        "import os, signal, time\n"
        "try:\n    os.kill(os.getpid(), signal.SIGINT); time.sleep(0.05)\n"
        "except BaseException:\n    pass\n"
        "whole = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "swallows", raising=False)


def test_an_interrupt_of_an_import_waits_for_its_end(step, tmp_path, monkeypatch, capsys):
    lost_in_an_import(tmp_path, monkeypatch)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    alarm = signal.getsignal(signal.SIGALRM)

    def work():
        import swallows

        assert swallows.whole
        time.sleep(10)

    step.does = work
    try:
        assert cli.main(["render", "shot.usda"]) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        assert signal.getsignal(signal.SIGALRM) is alarm
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "usdskin: error: interrupted.\n"


@pytest.mark.parametrize("becomes", [None, LayerError("x"), ValueError("x")])
def test_an_interrupt_that_was_lost_or_became_an_error_counts(step, becomes, capsys):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)

    def work():
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(10)
        except KeyboardInterrupt:
            if becomes is not None:
                raise becomes from None

    step.does = work
    try:
        assert cli.main(["render", "shot.usda"]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "usdskin: error: interrupted.\n"


def test_an_ignored_interrupt_stays_ignored(step):
    """A job in the background of a shell starts so."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    step.does = lambda: os.kill(os.getpid(), signal.SIGINT)
    try:
        assert cli.main(["render", "shot.usda"]) == 0
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.slow
def test_ctrl_c_ends_a_render_at_any_time(tmp_path):
    """From when the process listens, which it says here by its first line, to the first pixels."""
    stage = Path(__file__).resolve().parents[1] / "stages" / "sphere" / "sphere.usda"
    script = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from usdskin.stops import Stops; hear = Stops.hear; "
        "Stops.hear = lambda *a, **k: (hear(*a, **k), print('heard', flush=True))[0]; "
        "from usdskin.__main__ import run; run()"
    )
    output = tmp_path / "x.exr"
    command = [sys.executable, "-c", script, "-q", "render", str(stage), str(output), "-w", "3000"]
    for wait_s in [0.05 * step for step in range(14)]:
        child = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
        )
        assert child.stdout.readline() == "heard\n"
        time.sleep(wait_s)
        child.send_signal(signal.SIGINT)
        printed, told = child.communicate(timeout=60)
        assert (child.returncode, printed) == (130, ""), f"{wait_s} s: {told}"
        assert told.startswith("usdskin: error: interrupted.") and told.count("\n") == 1
        assert not output.exists()


def test_main_may_run_outside_the_main_thread(step):
    codes = []
    thread = threading.Thread(target=lambda: codes.append(cli.main(["render", "shot.usda"])))
    thread.start()
    thread.join()
    assert codes == [0]


def test_reader_that_went_away_ends_it_quietly():
    script = "import os; os.close(0)"
    command = f'"{sys.executable}" -m usdskin --help | "{sys.executable}" -c "{script}"'
    ran = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert "Traceback" not in ran.stderr


# Progress


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def test_plain_progress_is_a_line_a_tenth_with_the_time_left(capsys):
    clock = Clock()
    progress = PlainProgress(sys.stdout, clock)
    progress.start(100, "shade")
    for _ in range(100):
        clock.now += 1.0
        progress.advance()
    progress.done()
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 10
    assert lines[0] == "shade:  10 %  10.0 s, 90 s left"
    assert lines[-1] == "shade: 100 %  100.0 s, done"


def test_plain_progress_of_quick_work_is_its_last_line(capsys):
    progress = PlainProgress(sys.stdout, Clock())
    progress.start(100, "shade")
    for _ in range(100):
        progress.advance()
    assert capsys.readouterr().out == "shade: 100 %  0.0 s, done\n"


def test_progress_counts_threads_exactly():
    events = []
    progress = JsonProgress(events.append)
    progress.start(4000, "shade")
    threads = [
        threading.Thread(target=lambda: [progress.advance() for _ in range(1000)]) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [event["done"] for event in events] == list(range(400, 4001, 400))


def test_progress_may_be_ended_before_and_twice():
    for progress in (JsonProgress(print), PlainProgress(sys.stderr), TerminalProgress(sys.stderr)):
        progress.done()
        progress.advance()
        progress.start(2, "a")
        progress.start(2, "b")
        progress.advance(2)
        progress.done()
        progress.done()


@pytest.mark.parametrize(
    ("rate", "text"), [(3.24e6, "3.2 M/s"), (950.0, "950.0 /s"), (2e9, "2.0 G/s"), (1e3, "1.0 k/s")]
)
def test_rate_has_the_prefix_that_keeps_it_short(rate, text):
    assert format_rate(rate) == text


# Bad input, all the way through the real render

GOOD = """#usda 1.0
(
    metersPerUnit = 1
)
def Camera "Cam"
{
    float2 clippingRange = (0.1, 100)
    double3 xformOp:translate = (0, 0, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def DistantLight "Sun" (prepend apiSchemas = ["SpectralLightAPI"])
{
    uniform token inputs:spectral:source = "rgb"
}
def Mesh "Card" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(-1, -1, 0), (1, -1, 0), (0, 1, 0)]
    uniform token subdivisionScheme = "none"
    rel material:binding = </Skin>
}
def Material "Skin" (
    prepend apiSchemas = ["SkinMaterialAPI", "SpectralDistributionAPI:reflectance"]
)
{
    double[] spectrum:reflectance:wavelengths = [400, 700]
    double[] spectrum:reflectance:values = [0.3, 0.6]
}
"""


@pytest.fixture
def render_in(tmp_path, monkeypatch):
    """Return a function that renders a changed good stage in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run_render(*changes, arguments=()):
        text = GOOD
        for before, after in changes:
            assert before in text
            text = text.replace(before, after)
        Path("shot.usda").write_text(text)
        return cli.main(["-q", "render", "shot.usda", "o.exr", "-r", "8", "8", *arguments])

    return run_render


def test_good_stage_renders(render_in, capsys):
    assert render_in() == 0
    assert capsys.readouterr().out == "o.exr\no.png\n"


@pytest.mark.parametrize(
    "changes",
    [
        [(GOOD, "#usda 1.0\ndef {")],
        [('def Camera "Cam"', 'def Xform "Cam"')],
        [('def DistantLight "Sun"', 'def Xform "Sun"'), ('["SpectralLightAPI"]', '["x"]')],
        [('"SpectralLightAPI"', '"SpectralLigthAPI"')],
        [('source = "rgb"', 'source = "rbg"')],
        [("[400, 700]", "[700, 400]")],
        [("[400, 700]", "[400, 550, 700]")],
        [("[0.3, 0.6]", "[0.3, nan]")],
        [("[0.3, 0.6]", "[0.3, -0.6]")],
        [("double[] spectrum", "float inputs:skin:wrap = 2\n    double[] spectrum")],
        [("double[] spectrum", "asset inputs:skin:albedo:file = @no.png@\n    double[] spectrum")],
        [('source = "rgb"', 'source = "tabulated"')],
        [("metersPerUnit = 1", "metersPerUnit = 0")],
        [("metersPerUnit = 1", "timeCodesPerSecond = 0")],
    ],
)
def test_bad_stage_is_one_line_exit_code_3_and_no_file(render_in, changes, capsys, tmp_path):
    assert render_in(*changes) == 3
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("usdskin: error: ")
    assert printed.err.count("\n") == 1
    assert "shot.usda" in printed.err
    assert [path.name for path in tmp_path.iterdir()] == ["shot.usda"]


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["-cam", "/Nope"], 3),
        (["-rs", "/Nope"], 2),
        (["-r", "0", "5"], 2),
        (["-r", "1000000000", "1000000000"], 2),
        (["--integrator", "rays"], 2),
        (["--integrator", "map", "--aov", "visibility"], 2),
        (["--integrator", "traced", "--target-error", "2"], 2),
        (["--illuminant", "FL99"], 2),
        (["--view", "nope"], 2),
        (["--white", "nope"], 2),
        (["--set", "/Skin.inputs:skin:wrap=x"], 2),
        (["--variant", "/Skin{a=b}"], 2),
        (["--device", "cuda:99"], 6),
    ],
)
def test_bad_flag_is_one_line_and_no_file(render_in, arguments, code, capsys, tmp_path):
    assert render_in(arguments=arguments) == code
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["shot.usda"]


def test_output_that_cannot_be_written_is_one_line_and_exit_code_3(render_in, capsys, tmp_path):
    Path("file").write_text("")
    Path("shot.usda").write_text(GOOD)
    assert cli.main(["-q", "render", "shot.usda", "file/o.exr", "-r", "8", "8"]) == 3
    assert capsys.readouterr().err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "shot.usda"]


def test_missing_stage_is_one_line_and_exit_code_3(capsys):
    assert cli.main(["render", "/nowhere/shot.usda", "o.exr"]) == 3
    assert "/nowhere/shot.usda" in capsys.readouterr().err
