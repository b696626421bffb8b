"""Which of its arguments a user's function may use."""

from dis import get_instructions

LOOKING = {"locals", "vars", "dir", "eval", "exec"}  # functions that can read all variables


def may_read(function, position: int) -> bool:
    """Whether a function of Python may use the argument at this position."""
    code = function.__code__
    if position >= code.co_argcount or LOOKING.intersection(code.co_names):
        return True
    name = code.co_varnames[position]
    used = (each.argval for each in get_instructions(code))
    return name in code.co_cellvars or any(name == each or (type(each) is tuple and name in each) for each in used)
