"""The warnings that a test has caused."""


def told(recwarn) -> str:
    """The texts of all warnings so far, from pytest's fixture."""
    return "\n".join(str(each.message) for each in recwarn)
