"""MJCF scenes with all supported elements, as texts between <mujoco> tags."""

ROD = '<geom type="capsule" size="0.05" fromto="0 0 0 0.5 0.1 0.2"/>'
BRICK = '<inertial pos="0.1 0.2 -0.3" euler="10 20 30" mass="2" diaginertia="0.1 0.2 0.25"/>'


def world(*bodies, rest=""):
    return f"<worldbody>{''.join(bodies)}</worldbody>{rest}"


def body(inside, attributes=""):
    return f"<body {attributes}>{inside}</body>"


def chain(*levels):
    """A world of nested bodies, each a child of the previous one: (attributes, content)."""
    start = "".join(f'<body pos="0.3 -0.1 0.2" {attributes}>{inside}' for attributes, inside in levels)
    return world(start + "</body>" * len(levels))


TURNS = {
    "quat": 'quat="1 2 3 4"',
    "axisangle": 'axisangle="1 2 3 40"',
    "xyaxes": 'xyaxes="1 2 3 0 1 0.5"',
    "zaxis": 'zaxis="1 -2 3"',
    "zaxis down": 'zaxis="0 0 -1"',
    "euler": 'euler="10 20 30"',
}
JOINTS = {
    "hinge": '<joint axis="1 2 3" pos="0.1 0.2 0.3" ref="20" damping="0.3" armature="0.1"/>',
    "slide": '<joint type="slide" axis="1 2 -3" pos="0.1 0.2 0.3" ref="0.2" stiffness="3" springref="0.5"/>',
    "ball": '<joint type="ball" pos="0.1 0.2 0.3" damping="0.2" armature="0.1"/>',
    "three hinges": '<joint axis="1 0 0"/><joint axis="0 1 0" pos="0.1 0 0"/><joint pos="0 0.2 0"/>',
    "slides and ball": '<joint type="slide" axis="1 0 0"/><joint type="slide"/><joint type="ball" pos="0 0 1"/>',
    "hinge and slide": '<joint axis="0 1 0" ref="30" stiffness="2"/><joint type="slide" axis="0 1 0" ref="-0.3"/>',
}
GEOMS = {
    "sphere": '<geom size="0.1" mass="2"/>',
    "capsule": '<geom type="capsule" size="0.1 0.3" euler="10 20 30" pos="1 2 3"/>',
    "cylinder": '<geom type="cylinder" size="0.1 0.3" zaxis="1 2 3" density="300"/>',
    "ellipsoid": '<geom type="ellipsoid" size="0.1 0.2 0.3" quat="1 2 3 4" pos="0 1 0"/>',
    "box": '<geom type="box" size="0.1 0.2 0.3" xyaxes="1 1 0 0 1 1" mass="3"/>',
    "box by ends": '<geom type="box" size="0.1" fromto="0 1 0 0.5 0.1 0.2"/>',
    "ellipsoid by ends": '<geom type="ellipsoid" size="0.1" fromto="0 1 0 0.5 0.1 0.2"/>',
    "cylinder by ends": '<geom type="cylinder" size="0.1" fromto="0 1 0 0.5 0.1 0.2"/>',
    "several": ROD + '<geom size="0.1" pos="0.2 0 0"/><geom size="1" mass="0"/><geom size="1" density="0"/>',
}
SKEW = '<joint axis="1 1 0"/>'
CLASSES = f"""
<default>
  <joint damping="1" axis="0 1 0"/><geom density="500"/>
  <default class="a">
    <joint type="slide"/>
    <default class="b"><joint damping="2"/><geom size="0.2 0.3 0.4"/></default>
  </default>
</default>
<default>
  <joint armature="0.1"/>
  <default class="c"><geom mass="2" axisangle="1 2 3 40"/></default>
</default>
<worldbody>
  <body childclass="a">
    <joint/>{ROD}
    <body>
      <joint/>{BRICK}
      <body childclass="b" pos="1 0 0"><joint/><joint class="main" axis="1 0 0"/><geom type="box" size="0.5"/></body>
    </body>
    <frame childclass="c" pos="1 2 3">
      <body><joint axis="1 2 3"/><geom type="box" size="0.1 0.2 0.3" euler="10 20 30"/></body>
    </frame>
  </body>
</worldbody>"""
FRAMES = f"""
<worldbody>
  <frame pos="1 2 3" euler="10 20 30">
    <frame quat="1 2 0 0">
      <body pos="1 0 0" axisangle="1 0 0 20">
        {JOINTS["hinge"]}
        <frame pos="0 0 1" euler="0 30 0">
          <joint axis="1 0 0" pos="0.1 0 0"/>{ROD}<site name="s" pos="1 0 0" euler="1 2 3"/>
          <body><joint/>{ROD}</body>
        </frame>
        <joint type="slide"/>
      </body>
    </frame>
  </frame>
</worldbody>"""
ORDER = f"""
<worldbody>
  <body>
    <body><joint name="c"/>{ROD}</body>{ROD}<joint name="a"/>
    <frame><body><joint name="d"/>{ROD}</body><joint name="b" axis="1 0 0"/></frame>
  </body>
</worldbody>"""
FREE = body(BRICK + "<freejoint/>" + body(JOINTS["hinge"] + ROD, 'euler="5 6 7"'), 'pos="1 2 3" euler="10 20 30"')
ARMS = world(
    '<site name="w" pos="0 0 1" euler="40 0 0"/>',
    body('<joint name="l"/>' + ROD, 'name="a" euler="10 20 30"'),
    body(f'<joint name="r" type="slide" ref="0.1"/>{ROD}<site name="s" pos="0 1 0"/>', 'name="b" pos="1 0 0"'),
    rest="<equality>{}</equality>",
)
LOOSE = world(
    body('<joint type="ball"/>' + ROD, 'name="a" pos="1 2 3" euler="10 20 30"'),
    body('<joint type="ball"/>' + ROD, 'name="b" pos="3 1 0" euler="30 0 10"'),
    rest="<equality>{}</equality>",
)
RELPOSE = 'anchor="1 2 3" relpose="3 2 1 1 2 3 4"'
POLYCOEF = 'polycoef="0.1 2 0.3 -0.1 0.2"'

ZOO = {
    "free": world(FREE),
    "free with damping": world(body('<joint type="free" damping="0.4"/>' + BRICK)),
    "radian": '<compiler angle="radian"/>' + chain(('euler="0.1 0.2 0.3"', '<joint ref="0.4"/>' + ROD)),
    "welded bodies": chain(("", SKEW + ROD), (TURNS["quat"], ROD), (TURNS["zaxis"], BRICK), ("", "<joint/>" + ROD)),
    "full inertia": chain(
        ("", SKEW + "<joint/>" + '<inertial pos="1 2 3" mass="2" fullinertia="0.2 0.3 0.4 0.01 0.02 0.03"/>')
    ),
    "inertiafromgeom": '<compiler inertiafromgeom="true"/>' + chain(("", SKEW + BRICK + ROD), ("", "<joint/>" + BRICK)),
    "groups": '<compiler inertiagrouprange="1 2"/>'
    + chain(("", '<joint/><geom size="0.1" group="1"/><geom size="0.3" pos="1 0 0"/>')),
    "bounds": '<compiler boundmass="40" boundinertia="0.5"/>' + chain(("", SKEW + ROD)),
    "bound mass of an empty body": '<compiler boundmass="1" boundinertia="0.1"/>' + chain(("", SKEW)),
    "balance": '<compiler balanceinertia="true"/>' + chain(("", SKEW + BRICK.replace("0.25", "0.5"))),
    "total mass": '<compiler settotalmass="7"/>' + chain(("", ROD), ("", SKEW + BRICK)),
    "gravity": '<option gravity="1 2 3"/>' + chain(('gravcomp="0.3"', SKEW + ROD), ('gravcomp="2"', BRICK)),
    "classes": CLASSES,
    "frames": FRAMES,
    "several worlds": world(body('<joint name="a"/>' + ROD)) + world() + world(body('<joint name="b"/>' + BRICK)),
    "order": ORDER,
    "connect": ARMS.format('<connect body1="a" body2="b" anchor="1 2 3"/><connect body1="b" anchor="1 2 3"/>'),
    "connect sites": ARMS.format('<connect site1="s" site2="w"/><connect site1="w" site2="s" active="false"/>'),
    "weld": LOOSE.format('<weld body1="a" body2="b"/><weld body1="b" anchor="1 0 2" torquescale="0.3"/>'),
    "weld posed": LOOSE.format(f'<weld body1="a" body2="b" {RELPOSE}/><weld body1="world" body2="a"/>'),
    "weld sites": ARMS.format('<weld site1="s" site2="w"/>'),
    "joint": ARMS.format(f'<joint joint1="l" joint2="r" {POLYCOEF}/><joint joint1="r"/>'),
}
ZOO |= {f"joint {kind}": chain(("", joint + ROD), ('euler="5 6 7"', joint + BRICK)) for kind, joint in JOINTS.items()}
ZOO |= {f"turn {kind}": chain((turn, SKEW + ROD), (turn, "<joint/>" + BRICK)) for kind, turn in TURNS.items()}
ZOO |= {f"geom {kind}": chain(("", SKEW + "<joint/>" + geom)) for kind, geom in GEOMS.items()}
ZOO |= {
    f"eulerseq {sequence}": f'<compiler eulerseq="{sequence}"/>'
    + chain((TURNS["euler"], SKEW + BRICK), (TURNS["euler"], JOINTS["ball"] + BRICK))
    for sequence in ("xyz", "XYZ", "zyx", "zXz", "XyZ")
}
COPIED = body('<joint name="j"/>' + ROD)
ZOO |= {
    "replicate": world(f'<replicate count="3" offset="1 0 0" euler="0 0 20">{COPIED}</replicate>'),
    "aligned": world(body('<freejoint align="true"/>' + BRICK + body("<joint/>" + ROD, 'pos="1 2 3"'), 'pos="1 2 3"')),
    "all aligned": '<compiler alignfree="true"/>' + world(body('<joint type="free"/>' + ROD, 'euler="10 20 30"')),
    "springdamper": chain(("", '<joint springdamper="0.5 0.7" springref="20"/>' + ROD), ("", "<joint/>" + BRICK)),
    "shell": chain(("", SKEW + "<joint/>" + '<geom type="box" size="0.1 0.2 0.3" shellinertia="true"/>')),
    "inertial in a frame": chain(("", f'{SKEW}<frame pos="1 2 3" euler="10 20 30">{BRICK}</frame>')),
    "quat over euler": '<default><geom euler="10 20 30"/></default>'
    + chain(("", SKEW + "<joint/>" + '<geom type="box" size="0.1 0.2 0.3" quat="1 2 0 0"/>')),
    "static bodies to fuse": '<compiler fusestatic="true" discardvisual="true"/>'
    + chain(("", SKEW + ROD), (TURNS["quat"] + ' name="static"', BRICK)),
    "range of two turns": chain(("", '<joint axis="1 1 0" range="2 1"/>' + ROD)),
    "without effect": chain(
        ('name="a"', '<joint name="j"/><site name="s"/>' + ROD), ('name="b"', f'{SKEW}<site name="t"/>{BRICK}')
    )
    + '<contact><exclude body1="a" body2="b"/></contact><sensor><jointpos joint="j"/></sensor><size nuser_body="9"/>'
    + '<custom><numeric name="n" data="1"/></custom><tendon><spatial limited="true" range="0 1"><site site="s"/>'
    + '<site site="t"/></spatial></tendon><visual><map znear="0.1"/></visual>',
}

TENDONS = """<tendon><fixed name="t" {}><joint joint="l" coef="2"/><joint joint="r" coef="-0.5"/></fixed>
<fixed name="u"><joint joint="r" coef="1"/></fixed></tendon>"""
TIED = '<tendon tendon1="t" tendon2="u" polycoef="0.1 2 0.3 -0.1 0.2"/><tendon tendon1="u" polycoef="0.1 0 0 0 0"/>'
ZOO |= {
    "tendon with a spring": ARMS.format("") + TENDONS.format('stiffness="3" damping="0.4"'),
    "tendon with a slack spring": ARMS.format("") + TENDONS.format('stiffness="3" springlength="-0.1 0.2"'),
    "tendon with a length": ARMS.format("") + TENDONS.format('stiffness="3" springlength="0.7"'),
    "tied tendons": ARMS.format(TIED) + TENDONS.format("").replace('<joint joint="r" coef="-0.5"/>', "", 1),
    "tied tendons of one joint": ARMS.format(TIED.replace("0.3 -0.1 0.2", "0 0 0")) + TENDONS.format(""),
    "cable with a spring": ARMS.format("")
    + '<tendon><spatial stiffness="3" damping="0.4"><site site="s"/><site site="w"/></spatial></tendon>',
    "fluid": '<option density="1000" viscosity="3" wind="1 -2 0.5"/>'
    + chain(("", SKEW + BRICK), ('euler="5 6 7"', JOINTS["ball"] + ROD)),
    "ellipsoids in a fluid": '<option density="1000" viscosity="3" wind="1 -2 0.5"/>'
    '<default><geom fluidshape="ellipsoid" '
    'fluidcoef="0.4 0.3 1.2 0.9 0.8"/></default>'
    + chain(
        ("", SKEW + '<geom type="ellipsoid" size="0.1 0.2 0.3" euler="10 20 30" pos="0.1 0 0"/>' + ROD),
        ('euler="5 6 7"', JOINTS["ball"] + '<geom type="box" size="0.3 0.1 0.2" pos="0 0.1 0"/>'),
        (
            "",
            JOINTS["hinge"] + '<geom type="cylinder" size="0.1 0.3"/><geom size="0.1" fluidshape="none" pos="1 0 0"/>',
        ),
    ),
    "springs of a ball and a free joint": '<option gravity="0 0 0"/>'  # its armature is a mass without weight
    + world(
        body('<joint type="free" stiffness="2" armature="0.3"/>' + BRICK, 'pos="1 2 3" euler="10 20 30"'),
        body('<joint type="ball" stiffness="3" damping="0.2"/>' + ROD),
    ),
}
