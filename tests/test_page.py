"""The page in a real browser: every control is used as a person uses it, and the numbers that it tells are compared."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from helpers.browser import needs_browser, opened

import pinconsist as pc

pytestmark = needs_browser
SPEED = 0.5
PLACE = """(thing => {
  const seen = thing.getWorldPosition(new Vector3()).project(camera), box = pane.getBoundingClientRect();
  return [box.left + (1 + seen.x) / 2 * box.width, box.top + (1 - seen.y) / 2 * box.height];
})"""  # of a thing on the screen
WORDS = "element('{}').innerText"


@pytest.fixture(scope="module")
def run():
    mech = pc.load("four_bar")
    return mech, pc.simulate(mech, (0.0, 2.0))


@pytest.fixture(scope="module")
def page(run, tmp_path_factory):
    mech, sol = run
    file = tmp_path_factory.mktemp("page") / "four_bar.html"
    pc.export_html(mech, sol, file, forces=True, traces=["coupler_tip"], speed=SPEED)
    with opened(file) as tab:
        yield tab


@pytest.fixture
def tab(page):
    page.run("running = false; again.checked = true; seek(0); fit()")
    page.run("for (const box of Object.values(switches)) box.checked == (box.id != 'names') || box.click()")
    return page


def drawn(tab):
    """Wait until what was done is on the screen."""
    tab.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def force_at(sol, time):
    return np.linalg.norm(sol.at([time]).reaction("coupler_rocker").force)


def test_the_header_says_what_it_is_and_whether_to_believe_it(run, tab):
    assert tab.run("document.querySelector('h1').innerText") == "four_bar"
    assert tab.run("document.querySelector('header .ok').innerText") == run[1].check().verdict
    assert tab.run("getComputedStyle(document.querySelector('.dg')).display") == "none"  # meshcat's own controls


def test_playing_stepping_and_keys(tab):
    for start in (lambda: tab.click("#play"), lambda: tab.key(" ")):
        start()
        tab.wait("now > 0.05")
        start()
        stopped = tab.run("now")
        drawn(tab)
        assert tab.run("now") == stopped and not tab.run("running")
        tab.run("seek(0)")
    tab.click("#forth")
    assert tab.run("now") == pytest.approx(1 / 50)
    tab.key("ArrowRight")
    tab.click("#back")
    tab.key("ArrowRight")
    assert tab.run("now") == pytest.approx(2 / 50)
    tab.key("ArrowLeft")
    drawn(tab)
    assert tab.run(WORDS.format("time")) == f"t = {SPEED / 50:.2f} s"


@pytest.mark.parametrize(("step", "places"), [(0.02, 2), (0.01, 2), (0.0125, 4), (2e-5, 5), (1 / 30, 3), (3.0, 0)])
def test_the_time_has_the_decimals_of_its_steps(tab, step, places):
    """All of a round step, two of another."""
    assert tab.run(f"decimals({step})") == places


@pytest.mark.parametrize(("number", "unit", "words"), [
    (2.87e-6, "J", "2.87e-6 J"), (-0.00512, "N", "-0.00512 N"), (0.0, "rad", "0 rad"), (12345.0, "N", "12.3 kN"),
    (-4.5e7, "N·m", "-45 MN·m"), (12345.0, "m", "12300 m"), (0.00099951, "m", "0.001 m"),
])  # fmt: skip
def test_numbers_are_short(tab, number, unit, words):
    assert tab.run(f"short({number!r}, '{unit}')") == words


def test_speed_and_loop(tab):
    tab.run("speed.value = 4; speed.dispatchEvent(new Event('change')); seek(duration - 0.1)")
    assert tab.run("speed.selectedOptions[0].text") == f"× {4 * SPEED:g}"
    tab.key(" ")
    tab.wait("now < 1")  # from the start again
    assert tab.run("running")
    tab.click("#again")
    tab.run("seek(duration - 0.1)")
    tab.wait("!running")
    assert tab.run("now") == tab.run("duration") == 2.0 / SPEED
    tab.click("#play")
    tab.wait("running && now < 1")  # a run that has ended starts anew
    tab.run("speed.value = 1")


@pytest.mark.parametrize("handle", ["#scrub", "#plot"])
def test_dragging_the_time_shows_it_and_goes_on_playing(run, tab, handle):
    box = f"document.querySelector('{handle}').getBoundingClientRect()"
    left, width, y = tab.run(f"(box => [box.left, box.width, box.top + box.height / 2])({box})")
    tab.drag((left + 0.2 * width, y), (left + 0.75 * width, y))
    drawn(tab)
    time = tab.run("Math.abs(rate) * now")
    assert time == pytest.approx(1.5, abs=0.04) and not tab.run("running")
    assert tab.run("cursor.getBoundingClientRect().left") == pytest.approx(
        tab.run("(box => box.left + box.width * now / duration)(plot.getBoundingClientRect())"), abs=1
    )
    kind, name, told, unit, *peak = tab.run("element('curves').innerText").split()
    assert (kind, name, unit) == ("pin", "coupler_rocker:", "N")
    largest = run[1].reaction("coupler_rocker").peak()
    assert peak[::3] == ["peak", "at"] and float(peak[1]) == pytest.approx(largest.value, rel=6e-3)
    assert float(peak[4]) == pytest.approx(largest.t, abs=2e-3)
    assert float(told) == pytest.approx(force_at(run[1], time), rel=6e-3)
    tab.run("running = true")
    tab.drag((left + 0.75 * width, y), (left + 0.2 * width, y))
    assert tab.run("running") and tab.run("Math.abs(rate) * now") < 1.0


def test_each_group_of_curves_has_its_numbers(run, tab):
    mech, sol = run
    energies = {name: getattr(sol.energy(), name) for name in ("kinetic", "potential", "total")}
    times = np.array(tab.run("Array.from(curves[0].times)"))[:, None]  # in single precision; also between the rows
    rows = np.flatnonzero(np.abs(times - sol.t).min(axis=0) < 1e-6)  # those that the page has
    row = rows[len(rows) // 2]
    expected = {
        "forces": {"pin coupler_rocker": (np.linalg.norm(sol.reaction("coupler_rocker").force, axis=1)[row], "N")},
        "energy": {f"{name}, since the start": (values[row] - values[0], "J") for name, values in energies.items()},
        "angles": {name: (sol.position(name)[row], "rad") for name in mech.joints},
        "step": {"h": (sol.h[row - 1], "s")},
        "order": {"order": (sol.order[row - 1], "")},
        "joint forces": {name: (np.linalg.norm(sol.joint_force(name).force, axis=1)[row], "N") for name in mech.joints},
    }
    assert tab.run("[...element('groups').children].map(each => each.innerText)") == list(expected)
    for number, (group, curves) in enumerate(expected.items(), start=1):
        tab.click(f"#groups button:nth-child({number})")
        assert tab.run("element('groups').querySelector('[aria-selected=true]').innerText") == group
        told = tab.run(f"group.curves.map(curve => [curve.name, amount(curve, {sol.t[row]})])")
        assert [name for name, _ in told] == list(curves)
        for (_, words), (value, unit) in zip(told, curves.values(), strict=True):
            assert (
                float(words.split()[0]) == pytest.approx(value, rel=6e-3, abs=1e-9)
                and words.split()[1:] == unit.split()
            )
    for _ in range(2):  # the words of the curves are there while the page is paused, also when a group is chosen again
        tab.click("#groups button:nth-child(3)")
        drawn(tab)
        chips = tab.run("[...element('curves').children].map(each => each.innerText.split(':')[0])")
        assert chips == list(mech.joints)
    count = "plot.querySelectorAll('path.curve').length"
    assert tab.run(count) == 3 and tab.run("element('more').hidden")
    tab.click("#curves button:nth-child(2)")
    assert tab.run(count) == 2 and "click" in tab.run("element('more').innerText")
    assert tab.run("element('curves').children[1].getAttribute('aria-pressed')") == "false"
    tab.click("#curves button:nth-child(2)")
    tab.click("#groups button:nth-child(1)")


def test_switches_show_and_hide(tab):
    for name, part in {"forces": "force", "loops": "loop", "traces": "trace", "ground": "ground"}.items():
        seen = f"parts.{part}.map(each => each.visible)"
        assert all(tab.run(seen)), name
        tab.click(f"#{name}")
        assert not any(tab.run(seen)), name
        tab.click(f"#{name}")
        assert all(tab.run(seen)), name
    names = "[...document.querySelectorAll('.label.name')].filter(each => !each.hidden).map(each => each.innerText)"
    drawn(tab)
    assert tab.run(names) == []
    tab.click("#names")
    drawn(tab)
    assert sorted(tab.run(names)) == ["coupler_bar", "coupler_rocker", "crank_bar", "rocker_bar"]


def test_what_is_under_the_pointer_tells_its_name_and_force(run, tab):
    tab.run("seek(0.5)")
    drawn(tab)
    force = force_at(run[1], 0.5 * SPEED)
    body = "parts.body.find(part => part.userData.name == '{}' && part.geometry.type == 'BoxGeometry')"
    for thing, name, of_loop in (
        ("parts.loop[0]", "coupler_rocker", True),
        (body.format("rocker_bar"), "rocker_bar", True),
        (body.format("crank_bar"), "crank_bar", False),
    ):
        tab.mouse("mouseMoved", *tab.run(f"{PLACE}({thing})"))
        drawn(tab)
        assert not tab.run("hint.hidden")
        told = tab.run("hint.innerText").split("\n")
        assert len(told) == (name != "coupler_rocker") + of_loop
        assert told[0] == name or name == "coupler_rocker"
        if of_loop:
            what, number = told[-1].split(": ")
            assert what == "pin coupler_rocker" and number.endswith(" N")
            assert float(number.split()[0]) == pytest.approx(force, rel=6e-3)
    tab.mouse("mouseMoved", 3, 3)
    drawn(tab)
    assert tab.run("hint.hidden")


@pytest.mark.parametrize("corner", [(3, 3), (-3, 3), (3, -3), (-3, -3)])
def test_what_is_told_of_a_thing_stays_within_the_picture(tab, corner):
    """Whatever place of the pane it is at."""
    box = "(box => [box.left, box.top, box.right, box.bottom])({}.getBoundingClientRect())"
    left, top, right, bottom = tab.run(box.format("pane"))
    x, y = (right if corner[0] < 0 else left) + corner[0], (bottom if corner[1] < 0 else top) + corner[1]
    tab.mouse("mouseMoved", x, y)
    tab.run("under = parts.loop[0].userData; tell(performance.now() + TELLING)")
    at = tab.run(box.format("hint"))
    assert left <= at[0] < at[2] <= right and top <= at[1] < at[3] <= bottom
    assert not (at[0] <= x <= at[2] and at[1] <= y <= at[3])  # nor does it hide the thing
    tab.mouse("mouseMoved", 3, 3)


def test_peaks_keep_off_the_frame_and_each_axis_has_labels(tab):
    for number in range(1, 6):
        tab.click(f"#groups button:nth-child({number})")
        assert tab.run("plot.querySelectorAll('.left').length") >= 2
        boxes = tab.run(
            "[...svg.querySelectorAll('.curve')].map(each => each.getBBox()).map(box => [box.y, box.height])"
        )
        assert boxes and all(0.0 <= y and y + height <= 1.0 for y, height in boxes)
        if tab.run("group.name") not in ("step", "order"):
            assert min(y for y, _ in boxes) > 0.02 and max(y + height for y, height in boxes) < 0.98
    tab.click("#groups button:nth-child(1)")


SEEN = """points.map(point => point.clone().project(camera)).map(seen => [seen.x, seen.y])"""


def test_the_view_shows_all_and_comes_back(tab):
    home = np.array(tab.run(SEEN))
    assert 0.8 < np.abs(home).max() < 1.0
    x, y = tab.middle("#meshcat-pane")
    tab.drag((x, y), (x + 150, y + 60))
    tab.mouse("mouseMoved", x, y)
    drawn(tab)
    assert np.abs(np.array(tab.run(SEEN)) - home).max() > 0.1
    tab.click("#reset")
    drawn(tab)
    np.testing.assert_allclose(tab.run(SEEN), home, atol=1e-6)


def test_the_bar_of_the_legend_is_as_long_as_its_force(run, tab):
    """The arrow at some time, in pixels for each newton, beside the bar."""
    tab.run("seek(0.5)")
    drawn(tab)
    newtons = float(tab.run("replay.legend.find(each => each.bar).bar.text").split()[0])
    ends = tab.run("""["shaft", "head"].map(part => {
      const seen = object("/forces/coupler_rocker/" + part).getWorldPosition(new Vector3()).project(camera);
      return [seen.x * pane.clientWidth / 2, seen.y * pane.clientHeight / 2];
    })""")
    head = "object('/forces/coupler_rocker/head')"
    high = tab.run(f"{head}.scale.y * {head}.children[0].children[0].geometry.parameters.height * pixels()")
    shown = np.linalg.norm(np.subtract(*ends)) + high
    bar = tab.run("document.querySelector('#legend b').getBoundingClientRect().width")
    assert shown / bar == pytest.approx(force_at(run[1], 0.5 * SPEED) / newtons, rel=0.02)


@pytest.mark.parametrize(("scene", "planar"), [("four_bar", True), ("delta_robot", False)])
def test_on_a_phone_the_scene_fills_the_width_and_text_can_be_read(tmp_path, scene, planar):
    mech = pc.load(scene)
    file = pc.export_html(mech, pc.simulate(mech, (0.0, 0.2)), tmp_path / "page.html", forces=True)
    with opened(file, (390, 844), mobile=True) as tab:
        drawn(tab)
        assert tab.run("[innerWidth, document.documentElement.scrollWidth]") == [390, 390]
        assert tab.run("camera.isOrthographicCamera === true") == planar
        assert 0.85 < np.abs(tab.run(SEEN)).max() < 1.0
        for part in ("header", "#meshcat-pane", "#player", "#plot"):
            assert tab.run(f"document.querySelector('{part}').getBoundingClientRect().bottom") <= 844, part


def test_on_a_phone_a_tap_tells_and_a_swipe_scrolls(run, tmp_path):
    sol = run[1]
    with opened(sol.export_html(tmp_path / "page.html", forces=True), (390, 844), mobile=True) as tab:
        tab.run("running = false; seek(0.5)")
        drawn(tab)
        x, y = tab.run(f"{PLACE}(parts.loop[0])")
        tab.touch((x, y))
        drawn(tab)
        assert tab.run("hint.innerText.split(': ')[0]") == "pin coupler_rocker" and not tab.run("hint.hidden")
        told = float(tab.run("hint.innerText").split()[-2])
        assert told == pytest.approx(force_at(sol, 0.5), rel=6e-3)
        across, down = tab.middle("#meshcat-pane")
        tab.touch((across, down - 150))
        drawn(tab)
        assert tab.run("hint.hidden")
        before = tab.run("camera.position.toArray()")
        tab.touch((across, down + 100), (across, down + 80), (across, down), (across, down - 100))
        tab.wait("scrollY > 0 && scrollY >= document.documentElement.scrollHeight - innerHeight - 1")
        assert tab.run("camera.position.toArray()") == pytest.approx(before, rel=0.02)
        tab.run("scrollTo(0, 0)")
        tab.touch((across - 100, down), (across - 80, down), (across, down), (across + 100, down))
        tab.wait(f"camera.position.distanceTo(new Vector3(...{before})) > 0.1 * size")


def test_the_bare_page_has_the_motion_and_its_player_alone(run, tmp_path):
    sol = run[1]
    bare, full = (sol.export_html(tmp_path / f"{panel}.html", panel=panel, forces=True) for panel in (False, True))
    assert bare.stat().st_size < full.stat().st_size
    with opened(bare) as tab:
        tab.wait("now > 0")
        for part, there in {
            "header": False,
            "#panel": False,
            "#player": True,
            "#switches": True,
            "#legend": True,
        }.items():
            assert (tab.run(f"document.querySelector('{part}').getBoundingClientRect().height") > 0) == there, part


def test_a_peak_that_is_cut_tells_its_size(tmp_path):
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 2.0), t_eval=np.linspace(0.0, 2.0, 201))
    sol = replace(sol, lam=np.where(np.abs(sol.t[:, None] - 1.0) < 0.025, 40.0, 1.0) * sol.lam)
    with opened(pc.export_html(mech, sol, tmp_path / "peak.html", forces=True)) as tab:
        label = "(each => each.hidden ? '' : each.innerText)(document.querySelector('.label.size'))"
        tab.run("running = false; seek(1.0)")
        drawn(tab)
        told, unit = tab.run(label).split()
        assert unit == "N" and float(told) == pytest.approx(force_at(sol, 1.0), rel=6e-3)
        told = tab.run("plot.querySelector('.above').innerText")  # nor does it flatten the curves
        largest = np.linalg.norm(sol.reaction("coupler_rocker").force, axis=1).max()
        assert float(told.split("peaks to ")[1].split()[0]) == pytest.approx(largest, rel=6e-3)
        tab.run("seek(0.2)")
        drawn(tab)
        assert tab.run(label) == ""


def made_up(t):
    """Rows without multipliers and velocities."""
    return SimpleNamespace(t=np.array(t), q=np.zeros((len(t), 3)))


@pytest.mark.parametrize(
    "sol", [made_up([0.5]), made_up([3.0, 2.0]), {"a": made_up([0.0, 1.0]), "b": made_up([0.0, 0.5])}]
)
def test_pages_of_little(tmp_path, sol):
    """One row, backward in time, two of different length; nothing but positions is known of them."""
    with opened(pc.export_html(pc.load("four_bar"), sol, tmp_path / "page.html")) as tab:
        drawn(tab)
        still = isinstance(sol, SimpleNamespace) and len(sol.t) == 1
        assert tab.run("panel.hidden") == tab.run("element('player').hidden") == still
        if not still:
            assert tab.run("[...element('groups').children].map(each => each.innerText)") == ["angles"]
            tab.run("running = false; seek(0.5)")
            drawn(tab)
            assert tab.run("element('curves').innerText").count("0 rad") == 3 * (2 if isinstance(sol, dict) else 1)
            end = sol.t[0] - 0.5 if isinstance(sol, SimpleNamespace) else 0.5
            assert tab.run("element('time').innerText") == f"t = {end:.2f} s"


def test_arrows_of_joint_forces_have_a_switch(run, tab):
    """Off at first beside other forces, on where there are none."""
    seen = "parts['joint force'].map(each => each.visible)"
    assert len(tab.run(seen)) == 2 * len(run[0].joints)
    tab.run("const box = switches['joint forces']; box.checked || box.click(); 0")
    assert all(tab.run(seen))
    tab.run("switches['joint forces'].click()")
    assert not any(tab.run(seen))


BOXES = """[...document.querySelectorAll('.label.name')].filter(each => !each.hidden).map(each => {
    const [box, frame] = [each, pane].map(part => part.getBoundingClientRect());
    return [box.left - frame.left, box.top - frame.top, frame.right - box.right, frame.bottom - box.bottom,
            box.left, box.right, box.top, box.bottom]; })"""


def covered(boxes):
    """For each label whether a later one covers it."""
    for k, (left, right, top, bottom) in enumerate(boxes[:, 4:] + (1, -1, 1, -1)):
        others = boxes[k + 1 :, 4:]
        across = (others[:, 0] < right) & (left < others[:, 1])
        yield (across & (others[:, 2] < bottom) & (top < others[:, 3])).any()


@pytest.mark.parametrize("size", [(1280, 900), (390, 844)])
def test_names_are_within_the_picture_and_cover_none(tmp_path, size):
    """Of four joints at one place at its lower edge."""
    model, joint = pin.Model(), 0
    for k, kind in enumerate(
        [pin.JointModelRY, pin.JointModelRX, pin.JointModelRZ, pin.JointModelRY, pin.JointModelRX]
    ):
        joint = model.addJoint(joint, kind(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -float(k == 1)])), f"joint_{k}")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    sol = pc.simulate(pc.Mechanism(model), (0.0, 0.1))
    with opened(sol.export_html(tmp_path / "page.html", forces=True), size, mobile=size[0] < 500) as tab:
        assert all(tab.run("parts['joint force'].map(each => each.visible)"))
        tab.run("running = false; seek(0.05); switches.names.click(); 0")
        drawn(tab)
        found = np.array(tab.run(BOXES))
    assert len(found) == 5 and found[:, :4].min() > -1.0
    assert not any(covered(found))


def test_of_many_names_on_a_phone_none_covers_another(tmp_path):
    """Of forty bodies at one place; those that have no room nearby are left out."""
    model, joint = pin.Model(), 0
    for k in range(40):
        joint = model.addJoint(joint, [pin.JointModelRY, pin.JointModelRX][k % 2](), pin.SE3.Identity(), f"joint_{k}")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.3, 0.0, 0.0]), np.eye(3)), pin.SE3.Identity())
    sol = pc.simulate(pc.Mechanism(model), (0.0, 0.01))
    with opened(sol.export_html(tmp_path / "page.html"), (390, 844), mobile=True) as tab:
        tab.run("running = false; seek(0); switches.names.click(); 0")
        drawn(tab)
        found = np.array(tab.run(BOXES))
    assert 5 <= len(found) < 40 and not any(covered(found))


def test_a_loop_and_a_body_of_one_name_are_both_named_and_links_without_mass_are_not(tmp_path):
    file = tmp_path / "leg.urdf"
    inertia = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    file.write_text(f"""<robot name="leg"><link name="base"/><link name="cross"/><link name="foot">{inertia}</link>
        <joint name="pitch" type="continuous"><parent link="base"/><child link="cross"/><axis xyz="0 1 0"/></joint>
        <joint name="roll" type="continuous"><parent link="cross"/><child link="foot"/><axis xyz="1 0 0"/></joint>
        </robot>""")
    tip = {"xyz1": (0.0, 0.0, -1.0), "xyz2": (0.0, 0.0, -1.0)}
    mech = pc.load(file).add_loops(
        pc.Loop("foot", "distance", "foot", "universe", **tip | {"xyz2": (1.0, 0.0, -1.0)}, length=1.0)
    )
    with opened(pc.simulate(mech, (0.0, 0.1)).export_html(tmp_path / "page.html")) as tab:
        assert tab.run("labels.map(each => each.word.innerText)") == ["foot", "foot"]
        assert sorted(tab.run("[...new Set(parts.body.map(each => each.userData.name))]")) == ["cross", "foot"]
