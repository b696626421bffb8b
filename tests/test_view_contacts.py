"""What touches, on pages and figures: planes, marks that light up, contact forces, gaps."""

from base64 import b64decode

import numpy as np
import pytest
from helpers import touching
from helpers.browser import needs_browser, opened
from helpers.pictures import arrow, shown, stated
from helpers.touching import G

import pinconsist as pc

COLOUR = """(() => {
  let hex;
  lights[0].thing.traverse(each => { if (each.material) hex = each.material.color.getHex(); });
  return hex;
})()"""


def states(page, name):
    """The codes of a mark over the frames."""
    (light,) = [each for each in page["lights"] if each["path"].endswith(f"contact {name}/mark")]
    return np.frombuffer(b64decode(light["states"]), "<f4").astype(int)


@pytest.fixture(scope="module")
def pushed():
    """A block that sticks to the floor until a rising force moves it at t = 0.5 g."""
    mech = touching.block(pc.Contact("heel", "z", friction=0.5), forces=[{"x": pc.Motion(speed=1.0)}])
    return mech, pc.simulate(mech, (0.0, 6.0))


def test_marks_tell_what_a_contact_does_and_arrows_its_force(pushed):
    mech, sol = pushed
    page = shown(mech, sol, forces=True)
    codes = states(page, "heel")
    t = np.linspace(0.0, 6.0, len(codes))
    assert set(codes) == {2, 3}
    assert t[np.argmax(codes == 3)] == pytest.approx(0.5 * G, abs=2.0 * t[1])
    _, vector = arrow(page, "/forces/heel")
    force = vector * stated(page)
    np.testing.assert_allclose(force[:, 2], G, rtol=1e-3)
    np.testing.assert_allclose(force[codes == 2, 0], -t[codes == 2], atol=0.02)
    texts = [each["text"] for each in page["legend"]]
    assert "contact: closed, or stuck" in texts and "contact: sliding" in texts and "contact: open" not in texts
    drawn = {each["path"] for each in page["commands"]}
    assert any(path.endswith("/plane 0") for path in drawn)


def test_an_impact_flashes_and_a_stop_lights_up():
    sol = pc.simulate(touching.ball(0.5), (0.0, 3.0), {"z": 1.0})
    page = shown(sol.mechanism, sol)
    codes = states(page, "z lower")
    t = np.linspace(0.0, 3.0, len(codes))
    first = np.sqrt(2.0 / G)
    assert codes[0] == 0 and codes[-1] == 1
    assert t[np.argmax(codes == 4)] == pytest.approx(first, abs=2.0 * t[1])
    assert "contact: impact" in [each["text"] for each in page["legend"]]


def test_ropes_and_curves_of_gaps():
    rope = pc.Rope("rope", "universe", "z", length=0.7)
    mech = touching.block(rope)
    sol = pc.simulate(mech, (0.0, 1.0), [0.0, 0.0])
    page = shown(mech, sol, beside=True)
    groups = {each["name"]: each for each in page["panel"]["groups"]}
    assert [each["name"] for each in groups["gaps"]["curves"]] == ["rope"]
    assert "rope" in [each["name"] for each in groups["forces"]["curves"]]
    assert any(each["path"].endswith("/contacts/rope/mark") for each in page["lights"])


def test_runs_without_contacts_have_no_lights():
    mech = pc.load("four_bar")
    page = shown(mech, pc.simulate(mech, (0.0, 0.2)))
    assert page["lights"] == [] and not any("contact" in each["text"] for each in page["legend"])


def test_a_figure_has_gaps_and_forces(pushed):
    figure = pushed[1].plot("contacts")
    left, right = figure.axes
    assert "gaps" in left.get_title(loc="left") and "forces" in right.get_title(loc="left")
    with pytest.raises(pc.InputError, match="no contacts to draw"):
        pc.simulate(touching.ball().with_contacts(), (0.0, 0.1)).plot("contacts")


@needs_browser
@pytest.mark.parametrize(("size", "mobile"), [((1280, 800), False), ((390, 844), True)])
def test_the_page_lights_up(pushed, tmp_path, size, mobile):
    mech, sol = pushed
    file = pc.export_html(mech, sol, tmp_path / "page.html", forces=True)
    with opened(file, size, mobile) as tab:
        tab.run("running = false")
        tab.run(f"own = viewer.render.bind(viewer); viewer.render = () => {{ own(); drawn = {COLOUR}; }}; 0")
        seen = []
        for time in (1.0, 5.5):
            tab.run(f"seek({time})")
            tab.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            seen += [tab.run(COLOUR), tab.run("drawn")]
        assert seen == [0x2E7D32, 0x2E7D32, 0xF57C00, 0xF57C00]
        assert tab.run("document.documentElement.scrollWidth") <= size[0]
        assert tab.run("complaints") == []
