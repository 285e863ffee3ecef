"""Long runs on the command line: interrupted, gone on with, and on a cluster."""

import json
import logging
import signal
import subprocess
import sys
import time

import pytest

distributed = pytest.importorskip("distributed")
import dask  # noqa: E402

DENSITY = ["fig3a", "--method", "montecarlo", "--of", "q2", "--at", "0:1:0.25", "--json"]
GRID = ["--vary", "contact.stiffness=0.01:100:log2", "--paths", 4096, "--time", 60, "--seed", 3]


def begun(folder):
    """Whether a state of the sampling itself is in ``folder``."""
    return any(b"record_" in p.read_bytes() for p in folder.glob("*.checkpoint"))


def test_control_c_leaves_a_partial_result_and_exit_1(fpk, tmp_path):
    """Until then a second process on the same folder is refused."""
    command = ["density", *DENSITY, "--seconds", "400", "--checkpoint", str(tmp_path)]
    process = subprocess.Popen(
        [sys.executable, "-c", "from cases.command.cli import main; main()", *command],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while process.poll() is None and not begun(tmp_path):
        time.sleep(0.05)
    assert process.poll() is None
    status, _, refusal = fpk("density", *DENSITY, "--seconds", "400", "--checkpoint", tmp_path)
    assert status == 2 and "another process is using this folder" in refusal
    assert refusal.count("\n") == 1
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    record = json.loads(out)
    assert process.returncode == 1 and "partial: interrupted after" in err and "Trace" not in err
    failures = record["certificate"]["failures"]
    assert any("partial" in words for words in failures) and record["density"][0] > 0.3


def test_states_of_another_run_or_damaged_ones_are_refused_and_a_finished_answer_stays(
    answer, refusal, tmp_path
):
    folder = ["--checkpoint", tmp_path]
    first, again = (answer("density", *DENSITY[:-1], *folder) for _ in range(2))
    for key in ("density", "error", "certificate"):
        assert first[key] == again[key]
    for arguments in ([*DENSITY, "--seed", 9], ["fig6b", *DENSITY[1:]]):
        assert "another run" in refusal("density", *arguments, *folder)
    (state,) = tmp_path.glob("*.checkpoint")
    state.write_bytes(state.read_bytes()[:-5])
    assert "is damaged" in refusal("density", *DENSITY, *folder)
    refusal("run", "fig6a", *folder)
    for damaged in ("x", "[" * 100_000, '{"run":' * 100_000, ""):
        (tmp_path / "run.json").write_text(damaged)
        assert "another run" in refusal("density", *DENSITY, *folder)


@pytest.mark.parametrize("command", [["density", *DENSITY], ["regime", "fig6a", *GRID]])
def test_a_cluster_that_does_not_answer_is_one_line(command, refusal, monkeypatch):
    monkeypatch.setattr("sim.sample.workers.SCHEDULER_TIMEOUT", 0.5)
    assert "no Dask scheduler" in refusal(*command, "--cluster", "tcp://127.0.0.1:9")


@pytest.mark.slow
def test_a_density_and_a_map_are_the_same_on_a_cluster(fpk, tmp_path):
    def both(*where):
        status, out, _ = fpk("density", *DENSITY, *where)
        assert status == 0
        found = json.loads(out)
        folder = tmp_path / str(len(where))
        status, out, _ = fpk("regime", "fig6a", *GRID, "--json", "--checkpoint", folder, *where)
        assert status == 0 and len((folder / "points.jsonl").read_text().splitlines()) == 2
        points = [{**point, "seconds": 0} for point in json.loads(out)["points"]]
        return {key: found[key] for key in ("density", "error", "certificate")}, points

    with (
        dask.config.set({"distributed.logging.distributed": "critical"}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0",
            silence_logs=logging.CRITICAL,
        ) as local,
    ):  # fmt: skip
        there = both("--cluster", local.scheduler_address)
    assert there == both()


def test_control_c_does_not_wait_for_threads_that_are_at_work():
    code = (
        "import signal, time\n"
        "from concurrent.futures import ThreadPoolExecutor\n"
        "from cases.command import app, cli\n"
        "def run_app():\n"
        "    ThreadPoolExecutor(1).submit(time.sleep, 600)\n"
        "    signal.raise_signal(signal.SIGINT)\n"
        "app.run_app = run_app\n"
        "cli.main()\n"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (130, "fpk: stopped; nothing half-written was left\n")
