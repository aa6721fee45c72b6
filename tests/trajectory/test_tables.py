"""Tables of a run: each column is the number of the run that its name says, in pandas, xarray and CSV files."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.errors import InputError
from contactvi.importing.joint_kinds import joint_model
from contactvi.records.table import Table
from contactvi.scene.coordinates import coordinates
from contactvi.trajectory.tables import OF_NODES, TABLES
from helpers.run_scenes import slider_scene

pandas = pytest.importorskip("pandas")
xarray = pytest.importorskip("xarray")

MODELS = Path(__file__).resolve().parents[2] / "models"
KINDS = ("revolute", "continuous", "prismatic", "helical", "planar", "translation", "spherical", "free")


def model_of_all_kinds() -> pin.Model:
    """A chain with a joint of each kind."""
    model, parent = pin.Model(), 0
    for kind in KINDS:
        joint = joint_model(kind, np.array([0.0, 0.6, 0.8]), 0.1)
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array([0.0, 0.1, 0.2])), kind)
        model.appendBodyToJoint(parent, pin.Inertia(1.0, np.array([0.1, 0.2, 0.3]), np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(f"{kind}_body", parent, pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0])), 0)
    return model


@pytest.fixture(scope="module")
def run() -> cvi.Trajectory:
    """A box slides to rest beside a ball that bounces on it, with a joint limit that is hit."""
    scene = cvi.Scene()
    scene.add_urdf(MODELS / "double_pendulum.urdf", placement=(3.0, 0.0, 3.0))
    scene.set_joint("joint_2", limits=(-0.3, 0.3))
    scene.add_halfspace()
    scene.add_box("box", size=(0.4, 0.4, 0.1), mass=2.0, placement=(0, 0, 0.05))
    scene.add_sphere("ball", radius=0.1, mass=0.5, placement=(0, 0, 0.6))
    scene.set_contact(restitution=0.3, friction=0.4)
    q0 = scene.configuration({"joint_1": 0.5})
    return cvi.simulate(
        scene, q0, scene.velocity({"box": (0.3, 0, 0), "joint_2": 2.0}), dt=2e-3, duration=1.0, order=4, dense=True
    )


def test_coordinates_of_all_joints():
    """Each name says which number it is: a turn of the joint alone moves it."""
    model = model_of_all_kinds()
    names = coordinates(model)
    assert (len(names.q), len(names.v)) == (model.nq, model.nv)
    assert list(names.q)[:4] == ["revolute", "continuous.cos", "continuous.sin", "prismatic"]
    assert [name for name in names.q if name.startswith("free")] == [
        "free.x", "free.y", "free.z", "free.qx", "free.qy", "free.qz", "free.qw",
    ]  # fmt: skip
    assert [names.v[name] for name in names.v if name.startswith("planar")] == ["m/s", "m/s", "rad/s"]
    q0 = pin.neutral(model)
    ends = {"vx": "x", "vy": "y", "vz": "z", "wx": "qx", "wy": "qy", "wz": "qz"}
    for k, name in enumerate(names.v):
        step = np.zeros(model.nv)
        step[k] = 0.01
        moved = pin.integrate(model, q0, step) - q0
        joint, _, part = name.rpartition(".")
        number = {"continuous": "continuous.sin"}.get(joint, joint) if part == "v" else f"{joint}.{ends[part]}"
        number = "planar.sin" if name == "planar.wz" else number
        largest = list(names.q)[int(np.argmax(np.abs(moved)))]
        assert largest == number


def test_names_are_not_given_twice():
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "a")
    model.addJoint(first, pin.JointModelRX(), pin.SE3.Identity(), "a.v")
    names = coordinates(model)
    assert list(names.q) == ["a", "a.v"]
    assert list(names.v) == ["a.v'", "a.v.v"]


def test_states(run):
    frame = run.to_pandas()
    assert frame.index.name == "t"
    assert np.array_equal(frame.index, run.t)
    assert np.array_equal(frame["ball.z"], run.q[:, run.scene.q_index("ball")][:, 2])
    assert np.array_equal(frame["joint_2.v"], run.v[:, run.scene.v_index("joint_2")][:, 0])
    assert np.array_equal(frame.to_numpy(), np.column_stack([run.q, run.v]))
    units = frame.attrs["units"]
    assert set(units) == {"t", *frame.columns}
    assert (units["joint_1"], units["joint_1.v"], units["box.x"], units["box.qw"]) == ("rad", "rad/s", "m", "1")


def test_energies(run):
    frame = run.to_pandas("energies")
    for name in ("kinetic_energy", "energy", "impact_loss", "friction_loss", "modified_energy"):
        assert np.array_equal(frame[name], getattr(run, name))
    assert np.array_equal(frame["work_damping"], run.work.damping)


def test_contacts(run):
    """Columns against the objects of the log, row by row; an impact has no force."""
    frame, log = run.to_pandas("contacts"), run.contacts
    assert len(frame) == len(log) > 500
    for k in range(0, len(log), 37):
        row, contact = frame.iloc[k], log[k]
        assert (row["t"], row["h"], row["first"], row["second"]) == (contact.t, contact.h, *contact.pair)
        assert (row["pair"], row["point"], row["mode"]) == (" | ".join(contact.pair), contact.point, contact.mode)
        assert np.array_equal(row[["x", "y", "z"]].to_numpy(float), contact.position)
        assert np.array_equal(row[["fx", "fy", "fz"]].to_numpy(float), contact.force, equal_nan=True)
        if contact.kind == "limit":
            assert row["friction_force"] == 0.0
            assert row["first_body"] == ""
            continue
        assert {row["first_body"], row["second_body"]} <= {"ground", "box", "ball", "world", "lower", "upper"}
        if contact.h == 0.0:
            assert np.isnan(row["normal_force"])
            continue
        along = contact.force @ contact.normal
        across = np.linalg.norm(contact.force - along * contact.normal)
        assert row["normal_force"] == pytest.approx(along, rel=1e-12)
        assert row["friction_force"] == pytest.approx(across, rel=1e-9, abs=1e-12)
        assert row["friction_ratio"] == pytest.approx(across / (0.4 * along), rel=1e-9, abs=1e-12, nan_ok=True)
    sliding = frame[(frame["mode"] == "slip") & frame["has_force"] & (frame["pair"] == "ground | box")]
    assert len(sliding) > 50
    assert sliding["friction_ratio"].to_numpy() == pytest.approx(np.ones(len(sliding)), rel=1e-8)


def test_a_table_says_what_it_has():
    table = Table("runs", {"t": np.arange(3.0), "impacts": np.arange(3)}, {"t": "s"})
    assert repr(table) == "<Table 'runs': 3 rows, columns t [s], impacts>"


def test_events_and_changes(run):
    frame = run.to_pandas("events")
    assert len(frame) == len(run.events) > 3
    assert "limit" in set(frame["kind"])
    for row, event in zip(frame.itertuples(), run.events, strict=True):
        assert (row.t, row.first, row.second, row.method) == (event.time, *event.pair, event.method)
        assert np.array_equal([row.ix, row.iy, row.iz], event.impulse_vector)
        assert (row.impulse, row.gamma_plus, row.loss) == (event.impulse, event.gamma_plus, event.loss)
    changes = run.to_pandas("changes")
    assert [(row.t, row.point, row.change) for row in changes.itertuples()] == [
        (change.time, change.point, change.change) for change in run.contact_changes
    ]


def test_poses_of_all_joints():
    """Frames of bodies against Pinocchio's own kinematics, at drawn configurations."""
    from contactvi.trajectory.poses import body_poses, moving_bodies

    model = model_of_all_kinds()
    data = model.createData()
    bodies = moving_bodies(model)
    assert bodies == [f"{kind}_body" for kind in KINDS]
    q = np.array([pin.integrate(model, pin.neutral(model), np.sin(k + np.arange(model.nv))) for k in range(5)])
    position, quaternion = body_poses(model, q, bodies)
    for row, values in enumerate(q):
        pin.framesForwardKinematics(model, data, values)
        for k, name in enumerate(bodies):
            pose = data.oMf[model.getFrameId(name)]
            assert position[row, k] == pytest.approx(pose.translation, abs=1e-14)
            assert pin.Quaternion(quaternion[row, k]).matrix() == pytest.approx(pose.rotation, abs=1e-14)
    near = np.sum(quaternion[1:] * quaternion[:-1], axis=2)
    assert np.all(near >= 0.0)


def test_poses_of_a_run(run):
    ball = run.scene.parts[-1]
    poses = run.poses(ball)
    index = run.scene.q_index("ball")
    assert np.array_equal(poses.t, run.t)
    assert np.array_equal(poses.position, run.q[:, index][:, :3])
    times = [0.1234, 0.5]
    between = run.poses("ball", times)
    assert np.array_equal(between.position, run.at(times).q[:, index][:, :3])
    assert run.poses("ball", 0.25).position.shape == (1, 3)
    frame = run.to_pandas("poses")
    assert np.array_equal(frame[["ball.x", "ball.y", "ball.z"]], poses.position)
    assert np.array_equal(frame["ball.qw"], poses.quaternion[:, 3])
    assert np.all(run.poses("world").position == 0.0)
    with pytest.raises(cvi.InputError, match="Did you mean 'ball'"):
        run.poses("bal")


def test_xarray(run, tmp_path):
    data = run.to_xarray()
    assert np.array_equal(data["q"].sel(coordinate="ball.z"), run.to_pandas()["ball.z"])
    assert np.array_equal(data["position"].sel(body="ball"), run.poses("ball").position)
    assert np.array_equal(data["quaternion"].sel(body="ball"), run.poses("ball").quaternion)
    assert np.array_equal(data["contact_normal_force"], run.to_pandas("contacts")["normal_force"], equal_nan=True)
    assert (data["energy"].attrs["units"], data["contact_fx"].attrs["units"]) == ("J", "N")
    assert str(data["v_unit"].sel(dof="joint_1.v").item()) == "rad/s"
    force = data["contact_normal_force"].where(data["contact_second"] == "box").sum()
    assert float(force) > 0.0
    pytest.importorskip("scipy")
    data.to_netcdf(tmp_path / "run.nc", engine="scipy")
    with xarray.open_dataset(tmp_path / "run.nc", engine="scipy") as read:
        assert np.array_equal(read["q"], run.q)


def test_csv(run, tmp_path):
    """Numbers come back to the bit; units.csv names every column of every file."""
    written = run.to_csv(tmp_path / "tables")
    assert {path.name for path in written} == {
        *(f"{name}.csv" for name in TABLES if name not in ("dense_steps", "efforts", "forces")), "units.csv",
    }  # fmt: skip
    frame = pandas.read_csv(tmp_path / "tables" / "contacts.csv", dtype=str, keep_default_na=False)
    expected = run.table("contacts")
    assert list(frame.columns) == list(expected.columns)
    for name in ("t", "fx", "normal_force", "gap"):
        assert np.array_equal(frame[name].map(float), expected.column(name), equal_nan=True)
    assert frame["mode"].tolist() == expected.column("mode").tolist()
    states = np.loadtxt(tmp_path / "tables" / "states.csv", delimiter=",", skiprows=1)
    assert np.array_equal(states, np.column_stack([run.t, run.q, run.v]))
    with open(tmp_path / "tables" / "units.csv", newline="") as file:
        units = {(row["table"], row["column"]): row["unit"] for row in csv.DictReader(file)}
    assert units["states", "ball.vz"] == "m/s"
    assert {column for table, column in units if table == "contacts"} == set(expected.columns)
    assert [path.name for path in run.to_csv(tmp_path, ["dense_steps"])] == ["dense_steps.csv", "units.csv"]


def test_a_stored_run_has_the_same_tables(run, tmp_path):
    read = cvi.Trajectory.load(run.save(tmp_path / "run.npz"))
    for name in TABLES:
        pandas.testing.assert_frame_equal(read.to_pandas(name), run.to_pandas(name), check_exact=True)


def test_a_run_without_contacts_has_empty_tables():
    scene = cvi.Scene()
    scene.add_sphere("ball", radius=0.1, mass=1.0)
    traj = cvi.simulate(scene, dt=0.1, duration=0.3)
    for name in set(TABLES) - set(OF_NODES):
        frame = traj.to_pandas(name)
        assert len(frame) == 0
        assert frame.columns[0] == "t"
    assert not any(name.startswith("contact") for name in traj.to_xarray().data_vars)


def test_errors(run, tmp_path, monkeypatch):
    with pytest.raises(cvi.InputError, match="'states'"):
        run.to_pandas("state")
    (tmp_path / "file").write_text("")
    with pytest.raises(cvi.InputError, match="folder"):
        run.to_csv(tmp_path / "file")
    for package, call in (("pandas", run.to_pandas), ("xarray", run.to_xarray)):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(cvi.ContactviError, match=rf"contactvi\[{package}\]"):
            call()


@pytest.mark.parametrize("sample_dt", [None, 1e-2, 0.0137, 3.0, 1e-4])
def test_forces_of_windows_are_their_impulses(run, sample_dt):
    """Whatever the windows are; the impulse of each is that of the rows in it, which here a sum finds row by row."""
    table = run.table("forces", sample_dt)
    t, h = table.column("t"), table.column("h")
    assert t[0] == run.t[0]
    assert t[-1] + h[-1] == pytest.approx(run.t[-1])
    assert len(run.contacts.pairs) == 2
    for pair in run.contacts.pairs:
        rows = run.contacts.of(*pair)
        limit = rows[0].kind == "limit"
        names = [" | ".join(pair) + axis for axis in (("",) if limit else (".x", ".y", ".z"))]
        force = np.column_stack([table.column(name) for name in names])
        scale = np.abs(rows.impulse).sum()
        assert h @ force == pytest.approx(rows.impulse.sum(axis=0)[: len(names)], abs=1e-13 * scale)
        until = t[len(t) // 2]
        part = sum((c.impulse * (np.clip((until - c.t) / c.h, 0.0, 1.0) if c.h else float(c.t < until)) for c in rows),
                   np.zeros(3))  # fmt: skip
        first = t < until
        assert h[first] @ force[first] == pytest.approx(part[: len(names)], abs=1e-12 * scale)


def test_the_weight_of_a_box_at_rest(run):
    frame = run.to_pandas("forces", sample_dt=0.01)
    column = next(name for name in frame if "box" in name and "ground" in name and name.endswith(".z"))
    rest = frame[(frame["t"] > 0.9)][column]
    assert abs(rest).to_numpy() == pytest.approx((2.0 + 0.5) * 9.81, rel=0.05)


def test_windows_are_of_forces_alone(run):
    with pytest.raises(cvi.InputError, match="sample_dt"):
        run.to_pandas("states", sample_dt=0.1)
    for wrong in (0.0, -1.0, 1e-12, float("nan"), "fast"):
        with pytest.raises(cvi.InputError, match="sample_dt"):
            run.table("forces", wrong)
    flight = cvi.Scene()
    flight.add_sphere("ball", 0.1)
    assert len(cvi.simulate(flight, duration=0.1, dt=1e-2).table("forces")) == 0


def test_a_limit_in_persistent_contact_has_one_column():
    """A slider rests on its stop, which carries its weight."""
    run = cvi.simulate(slider_scene(0.0), dt=1e-2, duration=1.0)
    (pair,) = run.contacts.pairs
    table = run.table("forces", 0.1)
    assert list(table.columns) == ["t", "h", " | ".join(pair)]
    assert pair[1] == "lower limit"
    force = table.column(" | ".join(pair))
    assert force[-1] == pytest.approx(run.contacts.force_of(*pair)[1][-1, 0], rel=1e-9)
    assert force @ table.column("h") == pytest.approx(run.contacts.normal_impulse.sum(), rel=1e-12)


def test_a_column_that_a_table_does_not_have():
    table = Table("states", {"t": np.zeros(2), "height": np.ones(2)})
    with pytest.raises(InputError, match="expected t, height, got 'hieght'") as caught:
        table.column("hieght")
    assert "height" in caught.value.remedy
