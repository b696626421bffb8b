"""Small URDF texts for the tests of file formats."""

BAR = """<inertial><origin xyz="0.5 0 0"/><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.09" iyz="0" izz="0.08"/></inertial>"""
A = f'<link name="a">{BAR}</link>'
B = f'<link name="b">{BAR}</link>'
C = f'<link name="c">{BAR}</link>'


def joint(name="j", parent="a", child="b", kind="revolute", inside='<axis xyz="0 0 1"/>'):
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


CHAIN = (
    A + B + C + joint() + joint("k", "b", "c", inside='<origin xyz="1 0.1 0.2" rpy="0.3 0 0.2"/><axis xyz="0 1 1"/>')
)


def write(folder, body, loops=None, head='<robot name="r">', name="scene"):
    """Write a URDF, and a loop file if given, to a folder; return the path of the URDF."""
    path = folder / f"{name}.urdf"
    path.write_text(head + body + "</robot>")
    if loops is not None:
        (folder / f"{name}.yaml").write_text(loops)
    return path
