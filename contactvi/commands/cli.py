"""The command line: `contactvi run`, `play`, `plot`, `render`, `export`, `check`, `bench`, `verify` and more.

Exit codes: 0 done; 1 a case of verify failed, or a derivative; 2 wrong input, reported as expected, got, remedy; 3 the
run ended early, with its files written where it has some; 4 the run has no derivative; 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from contactvi.commands.console import (
    ENDED_EARLY,
    FAILED,
    NO_DERIVATIVE,
    WRONG_INPUT,
    Force,
    err,
    make_folder,
    out,
    print_error,
)
from contactvi.commands.export import export
from contactvi.commands.live import live_options, run_live
from contactvi.commands.output import PAGE, PLOTS, RUN, Phases, own_folder, print_summary, write_files
from contactvi.commands.pictures import CameraOption, camera_value, play, plot_run, render
from contactvi.errors import ContactviError, NotDifferentiable, SceneError, SimulationError
from contactvi.interrupts import held_back
from contactvi.keywords import synonym
from contactvi.status import StatusCode
from contactvi.tables import name_table, print_table
from contactvi.version import version
from contactvi.words import in_flags

PackageDir = Annotated[
    list[str] | None, typer.Option("--package-dir", help="Folder in which package:// is looked for; repeatable.")
]
Base = Annotated[
    str | None, typer.Option(help="Base of a URDF: fixed or free; by default what its SRDF says, else fixed.")
]
Srdf = Annotated[str | None, typer.Option(help="SRDF of a URDF: its disabled collisions and group states.")]
Allow = Annotated[
    list[str] | None,
    typer.Option(help="Take elements of an MJCF that are refused otherwise: flex, without elasticity; repeatable."),
]
Shape = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[NAME=]SHAPE",
        help="What its meshes become: hull, pieces or field; of a geometry or file alone by NAME=; repeatable.",
    ),
]
Spacing = Annotated[float | None, typer.Option(help="Of the samples of fields in metres; by default 1/40 of a mesh.")]
Configuration = Annotated[
    str | None, typer.Option(help="Start of a model: the name of a keyframe of the MJCF or of a state of the SRDF.")
]

SolverTol = Annotated[
    float | None,
    typer.Option(help="With a number as --dt: what the equations of a step are solved to, relative; 1e-12."),
]


class _Commands(typer.core.TyperGroup):
    """The commands; a ContactviError becomes a message and the exit code 2, never a traceback."""

    def invoke(self, ctx: Any) -> Any:
        try:
            with warnings.catch_warnings():
                warnings.showwarning = partial(self._show_warning, ctx, warnings.showwarning)
                return super().invoke(ctx)
        except ContactviError as error:
            if isinstance(error, SimulationError) and error.status and error.status.code == StatusCode.INTERRUPTED:
                raise KeyboardInterrupt from error
            print_error(error, self._flags(ctx))
            raise typer.Exit(NO_DERIVATIVE if isinstance(error, NotDifferentiable) else WRONG_INPUT) from error
        except Exception as error:
            if type(error).__name__ == "NoSuchOption":  # of click, or of the one that typer brings along
                self._name_what_is_meant(error, self._flags(ctx))
            raise

    def _name_what_is_meant(self, error: Any, flags: Mapping[str, str]) -> None:
        """Let the message on an unknown option lead to the one that others call so."""
        meant = synonym(str(error.option_name).lstrip("-").replace("-", "_"))
        if meant in flags:
            error.possibilities = [flags[meant]]

    def _show_warning(
        self, ctx: Any, other: Callable[..., None], message: Warning, category: type[Warning], *place: Any
    ) -> None:
        """Print a warning of ours in the words of the command line; others as Python does."""
        if category.__module__.partition(".")[0] != "contactvi":
            other(message, category, *place)
            return
        err.print(f"[bold yellow]Warning:[/] {escape(in_flags(str(message), self._flags(ctx)))}")

    def _flags(self, ctx: Any) -> dict[str, str]:
        """Return the flags of the command that was called, by the names of their arguments."""
        command = self.get_command(ctx, ctx.invoked_subcommand or "")
        options = [] if command is None else [param for param in command.params if param.opts[0].startswith("--")]
        return {str(param.name): max(param.opts, key=len) for param in options}


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _show_version(wanted: bool) -> None:
    if wanted:
        out.print(f"contactvi {version()}")
        raise typer.Exit()


@app.callback()
def main(
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version and stop.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Accurate rigid contact for URDF and MJCF models."""


@app.command()
def run(
    scene_file: Annotated[
        str,
        typer.Argument(metavar="FILE", help="Scene file (.toml), or a model: URDF, MJCF (.xml).", show_default=False),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder for the results, by default the name of the file."),
    ] = None,
    dt: Annotated[
        str | None,
        typer.Option(metavar="NUMBER|auto", help="Time step in seconds, or auto: chosen and measured to meet --tol."),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="Simulated time in seconds; a whole number of steps where dt is a number.")
    ] = None,
    impact: Annotated[str | None, typer.Option(help="Impact map: ctec, dtec or mhc.")] = None,
    mhc_reference: Annotated[
        str | None,
        typer.Option(help="The value that mhc conserves: local (of the step) or global (of the start of the run)."),
    ] = None,
    order: Annotated[int | None, typer.Option(help="Order of the integrator: 2, 4, ... 16.")] = None,
    tol: Annotated[float | None, typer.Option(help="With --dt auto: the accuracy of q, in m and rad.")] = None,
    solver_tol: SolverTol = None,
    dt_contact: Annotated[
        float | None,
        typer.Option(help="Length of contact steps, of order 2, in seconds: by default --dt, above order 2 1e-3."),
    ] = None,
    zeno: Annotated[
        str | None, typer.Option(help="Where impacts accumulate: hold (the contact) or end (the run).")
    ] = None,
    support: Annotated[
        str | None,
        typer.Option(help="Impacts on a body that rests on others: sequence, or stiff (the supports stay closed)."),
    ] = None,
    contact_mode: Annotated[
        str | None,
        typer.Option(help="In contact: auto, events (all are located) or steps (dense steps, no times of impacts)."),
    ] = None,
    record_every: Annotated[int | None, typer.Option(help="Keep the state every so many steps.")] = None,
    sample_dt: Annotated[float | None, typer.Option(help="Keep the state every so many seconds instead.")] = None,
    fps: Annotated[float, typer.Option(help="Frames per simulated second of the playback.")] = 60.0,
    camera: CameraOption = None,
    live: Annotated[bool, typer.Option("--live", help="Show the run in the browser, in real time.")] = False,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="With --live: open the page.")] = True,
    html: Annotated[bool, typer.Option("--html/--no-html", help="Write playback.html.")] = True,
    plot: Annotated[
        bool,
        typer.Option(
            "--plot/--no-plot",
            help="Draw at once what contactvi plot draws: energy.png, forces.png of contact, reactions.png of loops.",
        ),
    ] = False,
    base: Base = None,
    configuration: Configuration = None,
    height: Annotated[
        float | None, typer.Option(help="Height in metres from which a model with a free base is dropped, 0.05.")
    ] = None,
    package_dir: PackageDir = None,
    srdf: Srdf = None,
    allow: Allow = None,
    shape: Shape = None,
    spacing: Spacing = None,
    save_scene: Annotated[
        Path | None, typer.Option(metavar="SCENE.toml", help="Write the scene file that says what a run assumes.")
    ] = None,
    force: Force = False,
) -> None:
    """Run a scene or a model; write trajectory.npz and playback.html, with --plot what contactvi plot draws, too.

    A model with a free base is dropped on a plane; one with a fixed base is held, and its joints move limp. Files of an
    earlier run of the same scene are replaced, others only with --force.
    """
    view = camera_value(camera)
    phases = Phases()
    with phases.of("imports"):
        import contactvi as cvi
        from contactvi.commands.models import scene_to_run
        from contactvi.progress import RunProgress
        from contactvi.simulation.settings import settings_of

    title = Path(scene_file).stem
    chosen: dict[str, Any] = {
        "dt": _step(dt), "duration": duration, "impact": impact, "mhc_reference": mhc_reference, "order": order,
        "tol": tol, "solver_tol": solver_tol, "record_every": record_every, "sample_dt": sample_dt,
        "dt_contact": dt_contact, "zeno": zeno, "support": support, "contact_mode": contact_mode,
    }  # fmt: skip
    given = {
        "base": base, "configuration": configuration, "height": height, "package_dirs": package_dir, "srdf": srdf,
        "allow": allow, "shape": shape, "spacing": spacing,
    }  # fmt: skip
    with phases.of("build"):
        scene = scene_to_run(scene_file, given, save_scene, chosen, force)
        if view is not None:
            scene.camera = view
        if live:
            chosen = live_options(scene, chosen)
        settings = settings_of(scene, chosen)
        scene.core()
    folder = output if output is not None else Path(title)
    # Before the run: a long one must not fail when its files are written.
    make_folder(folder, (RUN, PAGE, *PLOTS), force or own_folder(folder, scene))
    with held_back() as ctrl_c:  # what was computed is written
        try:
            with RunProgress(settings.span, err) as bar, warnings.catch_warnings():
                for reported in (cvi.AccuracyWarning, cvi.DenseStepWarning):  # by the summary
                    warnings.simplefilter("ignore", reported)
                with phases.of("run"):
                    if live:
                        traj = run_live(scene, chosen, settings.steps, title, browser, bar, ctrl_c)
                    else:
                        traj = cvi.simulate(scene, progress=bar, **chosen)
        except SimulationError as error:
            traj = error.trajectory
        written = write_files(traj, folder, title, fps if html else None, plot, phases)
        print_summary(traj, written, phases, None if plot else folder)
    if traj.status.ok:
        ctrl_c.check()
    if not traj.status.ok:
        raise typer.Exit(ENDED_EARLY)


@app.command()
def bench(
    scene_file: Annotated[Path, typer.Argument(metavar="SCENE.toml", help="Scene file.", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder for the results, by default SCENE-bench."),
    ] = None,
    dt: Annotated[float | None, typer.Option(help="Time step in seconds around which the ladder is built.")] = None,
    duration: Annotated[float | None, typer.Option(help="Simulated time in seconds, a whole number of steps.")] = None,
    solver_tol: SolverTol = None,
    orders: Annotated[str, typer.Option(metavar="2,4,...", help="Orders to compare, from 2, 4, ... 16.")] = "2,4,8,16",
    budget: Annotated[float, typer.Option(help="Wall time allowed in seconds.")] = 60.0,
    force: Force = False,
) -> None:
    """Measure run time against error of a scene over orders, impact maps and steps; write bench.png and bench.csv."""
    import contactvi as cvi
    from contactvi.bench import report as bench_report
    from contactvi.bench.bench import bench as measure
    from contactvi.progress import JobProgress

    scene = cvi.load_scene(scene_file)
    folder = output if output is not None else Path(f"{scene_file.stem}-bench")
    make_folder(folder, ("bench.csv", "bench.png"), force)
    with JobProgress(err, time_left=False) as bar:
        chosen = [int(order) if order.strip().isdigit() else 0 for order in orders.split(",")]
        result = measure(
            scene, budget=budget, orders=chosen, progress=bar, dt=dt, duration=duration, solver_tol=solver_tol
        )
    out.print(bench_report.heading(result) + "\n", markup=False)
    print_table(out, bench_report.table(result))
    for line in ["", *bench_report.notes(result)]:
        out.print(line, markup=False)
    written = [
        bench_report.save_csv(result, folder / "bench.csv"),
        bench_report.save_plot(result, folder / "bench.png", scene_file.stem),
    ]
    print_table(
        out, name_table([("advice", bench_report.advice(result)), *(("written", str(path)) for path in written)])
    )


@app.command()
def reproduce(
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the results.")] = Path(
        "reproduction"
    ),
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer random starts and repeats: well under a minute.")
    ] = False,
    force: Force = False,
) -> None:
    """Measure the claims of the paper's Table I and draw its Fig. 1; write report.md, table.csv and pictures."""
    from contactvi.progress import JobProgress
    from contactvi.reproduce import reproduce as reproduction
    from contactvi.reproduce.report import summary as verdicts
    from contactvi.reproduce.report import verdict

    make_folder(output, ("report.md", "table.csv"), force)
    with JobProgress(err) as bar:
        result = reproduction.reproduce(output, quick=quick, progress=bar)
    print_table(out, name_table((row.key, verdict(row), row.measured) for row in result.rows))
    out.print(escape(verdicts(result.rows).replace("**", "")))
    out.print(f"Report: {escape(str(result.files[0]))}")


@app.command()
def verify(
    cases: Annotated[
        list[str] | None,
        typer.Argument(metavar="[CASE]...", help="Names of cases, by default all.", show_default=False),
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="Print the names of the cases and stop.")] = False,
    details: Annotated[
        bool | None,
        typer.Option("--details/--no-details", help="Print every number, by default of the cases that are named."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Measure the cases with known answers: verdict, expected, got, tolerance; exit code 1 unless all pass."""
    from contactvi.progress import JobProgress
    from contactvi.verify import report
    from contactvi.verify import verify as verification

    wanted = verification.chosen(cases or [])
    if listed:
        print_table(out, verification.listing(wanted))
        return
    with JobProgress(err, time_left=False) as bar:
        results = verification.verify(wanted, bar)
    if json:
        out.print(report.as_json(results), markup=False)
    else:
        for line in report.lines(results, bool(cases) if details is None else details):
            out.print(line, markup=False, style="bold red" if line.lstrip().startswith(verification.FAILED) else None)
        out.print()
    for line in report.summary(results):
        (err if json else out).print(line, markup=False)
    if not verification.passed(results):
        raise typer.Exit(FAILED)


app.command()(play)
app.command("plot")(plot_run)
app.command()(render)
app.command()(export)


@app.command()
def check(
    model: Annotated[
        str,
        typer.Argument(
            metavar="FILE",
            help="URDF, MJCF (.xml) or scene file (.toml); example-robot-data://robots/... works too.",
            show_default=False,
        ),
    ],
    package_dir: PackageDir = None,
    base: Base = None,
    srdf: Srdf = None,
    allow: Allow = None,
    shape: Shape = None,
    spacing: Spacing = None,
) -> None:
    """Print which data of a model are used, changed, ignored or refused, and what `contactvi run` assumes of it."""
    from contactvi.commands.models import choice_of, is_model, model_scene, print_assumed, read_scene

    given = {"base": base, "package_dirs": package_dir, "srdf": srdf, "allow": allow}
    choice = choice_of({**given, "shape": shape, "spacing": spacing})
    try:
        scene = read_scene(model, choice)
    except SceneError as error:
        if error.report is not None:
            from contactvi.importing.report import ImportReport

            out.print(str(ImportReport([error.report])), markup=False)
        raise
    out.print(str(scene.report), markup=False)
    if is_model(model) and scene.nv:
        out.print()
        print_assumed(model, model_scene(model, choice))


@app.command()
def check_gradient(
    scene_file: Annotated[Path, typer.Argument(metavar="SCENE.toml", help="Scene file.", show_default=False)],
    wrt: Annotated[
        str, typer.Option(metavar="NAME,...", help="With respect to what; restitution:a|b is that of one pair.")
    ] = "q0,v0,control,restitution,friction",
    columns: Annotated[int, typer.Option(help="Compare at most so many columns, some of each name.")] = 12,
    seed: Annotated[int, typer.Option(help="Which columns, where there are more.")] = 0,
    on_kink: Annotated[
        str, typer.Option(help="Where several contacts are hit at one instant: raise, or taken (the order of the run).")
    ] = "raise",
    dt: Annotated[float | None, typer.Option(help="Time step in seconds.")] = None,
    duration: Annotated[float | None, typer.Option(help="Simulated time in seconds, a whole number of steps.")] = None,
    impact: Annotated[str | None, typer.Option(help="Impact map: ctec, dtec or mhc.")] = None,
    mhc_reference: Annotated[str | None, typer.Option(help="The value that mhc conserves: local or global.")] = None,
    order: Annotated[int | None, typer.Option(help="Order of the integrator: 2, 4, ... 16.")] = None,
    solver_tol: SolverTol = None,
) -> None:
    """Compare the exact derivatives of a run with differences of it; exit code 1 where they disagree, 4 without."""
    import contactvi as cvi
    from contactvi.commands.gradient import lines, table
    from contactvi.progress import JobProgress

    scene = cvi.load_scene(scene_file)
    chosen: dict[str, Any] = {
        "duration": duration, "impact": impact, "mhc_reference": mhc_reference, "order": order,
        "solver_tol": solver_tol, "dt": dt, "wrt": [name.strip() for name in wrt.split(",")],
    }  # fmt: skip
    try:
        with JobProgress(err) as bar:
            found = cvi.check_gradient(scene, columns=columns, seed=seed, on_kink=on_kink, progress=bar, **chosen)
    except SimulationError as error:
        if error.status is not None and error.status.code != StatusCode.INTERRUPTED:
            print_error(error)
            raise typer.Exit(ENDED_EARLY) from error
        raise
    for line in lines(found):
        out.print(line, markup=False)
    print_table(out, table(found))
    out.print(f"\n{found}", markup=False)
    if not found.ok:
        raise typer.Exit(FAILED)


def _step(dt: str | None) -> float | str | None:
    """Return the value of --dt: a number, or the text for the checks of the options."""
    try:
        return None if dt is None else float(dt)
    except ValueError:
        return dt


if __name__ == "__main__":
    app()
