"""The commands that show stored runs: `contactvi play` and `contactvi render`."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from contactvi.commands.console import Force, make_folder, out
from contactvi.commands.output import RUN, draw_plots, run_file, run_title

CameraOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|JSON",
        help='auto, front, side, top, {"eye": [x, y, z], "target": [x, y, z]} or {"follow": "body"}; '
        "by default the scene's.",
    ),
]
RunFile = Annotated[
    Path, typer.Argument(metavar="RUN", help="Folder of a run, or its file (.npz).", show_default=False)
]


def camera_value(text: str | None) -> Any:
    """Return the camera of --camera for `to_html` and `render`. Raises InputError."""
    from contactvi.scene.camera import camera_of_text

    return None if text is None else camera_of_text(text).to_data()


def play(
    run: RunFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="PAGE.html", help="Page to write, by default beside the run."),
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page.")] = True,
    fps: Annotated[float, typer.Option(help="Frames per simulated second.")] = 60.0,
    camera: CameraOption = None,
    force: Force = False,
) -> None:
    """Write the playback of a run as a page of its own and open it in the browser."""
    import contactvi as cvi

    chosen, file = camera_value(camera), run_file(run)
    traj = cvi.Trajectory.load(file)
    target = output or file.with_suffix(".html")
    again = force or (output is None and _is_page(target))  # the page of this run is made anew
    page = traj.to_html(target, fps=fps, title=run_title(file), camera=chosen, overwrite=again)
    out.print(f"Playback: {escape(str(page))}")
    if browser and not webbrowser.open(page.resolve().as_uri(), new=2):
        out.print("No browser was found: open the page by hand.")


def plot_run(
    run: RunFile,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder for the plots, by default the run's.")
    ] = None,
    kind: Annotated[str, typer.Option("--format", help="png or svg.")] = "png",
    dpi: Annotated[float, typer.Option(help="Pixels per inch; the plots are ten inches wide.")] = 130.0,
    transparent: Annotated[bool, typer.Option("--transparent", help="No background.")] = False,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the plots.")] = True,
    force: Force = False,
) -> None:
    """Draw energy, contact forces and reactions of constraints: energy.png, forces.png, reactions.png; open them."""
    from contactvi.inputs import check_choice
    from contactvi.trajectory.trajectory import Trajectory

    check_choice("format", kind, ("png", "svg"), "Unknown format of a plot")
    file = run_file(run)
    again = force or (output is None and file.name == RUN)  # of a folder that contactvi run has made
    traj = Trajectory.load(file)
    folder = file.parent if output is None else output
    make_folder(folder)
    for path in draw_plots(traj, folder, kind, again, dpi=dpi, transparent=transparent):
        out.print(f"Plot: {escape(str(path))}")
        if browser and not webbrowser.open(path.resolve().as_uri(), new=2):
            out.print("No browser was found: open the plot by hand.")


def _is_page(path: Path) -> bool:
    """Return whether a file is a page that contactvi wrote."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return b'<meta name="generator" content="contactvi">' in file.read(1000)


def render(
    run: RunFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Ends with .gif, .mp4 or .png; by default RUN.gif."),
    ] = None,
    at: Annotated[float | None, typer.Option(help="Time of a .png in seconds.")] = None,
    camera: CameraOption = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Width and height in pixels, by default 640x480 for a .gif, else 800x600."),
    ] = None,
    fps: Annotated[float, typer.Option(help="Frames per second of the film.")] = 25.0,
    speed: Annotated[float, typer.Option(help="Simulated seconds per second of the film.")] = 1.0,
    start: Annotated[float | None, typer.Option(help="Time at which the film begins, in seconds.")] = None,
    end: Annotated[float | None, typer.Option(help="Time at which it ends.")] = None,
    forces: Annotated[bool, typer.Option("--forces/--no-forces", help="Arrows of forces and impulses.")] = True,
    labels: Annotated[bool, typer.Option("--labels", help="Names of the bodies.")] = False,
    ground: Annotated[
        bool | None,
        typer.Option("--ground/--no-ground", help="Ground and walls; a transparent .png has only the shadows on them."),
    ] = None,
    force_scale: Annotated[
        float | None, typer.Option(help="Newtons whose arrow is a metre long, to compare pictures.")
    ] = None,
    transparent: Annotated[bool, typer.Option("--transparent", help="A .png without a background.")] = False,
    dpi: Annotated[float | None, typer.Option(help="Pixels per inch that a .png says it has.")] = None,
    force: Force = False,
) -> None:
    """Draw a run as a GIF, an MP4 or a PNG, by Chromium without a window; an MP4 needs ffmpeg."""
    import contactvi as cvi

    chosen, file = camera_value(camera), run_file(run)
    traj = cvi.Trajectory.load(file)
    target = output or file.with_suffix(".gif" if at is None else ".png")
    written = traj.render(
        target,
        camera=chosen,
        size=size,
        at=at,
        fps=fps,
        speed=speed,
        start=start,
        end=end,
        forces=forces,
        labels=labels,
        ground=ground,
        force_scale=force_scale,
        transparent=transparent,
        dpi=dpi,
        overwrite=force,
    )
    out.print(f"{escape(str(written))}  ({written.stat().st_size / 1e6:.2g} MB)")
