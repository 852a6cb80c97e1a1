"""What compiled functions must not do, as numba compiles it wrongly without a word."""

import ast
from pathlib import Path

import csstsim

SOURCE = Path(csstsim.__file__).parent


def unpacked_into_fields(text: str) -> list[int]:
    """Return the lines of compiled functions that unpack into the arrays of a record: `a.x[k], a.y[k] = pair`.

    numba 0.68 frees such arrays of a NamedTuple at the first turn of the loop; what is read later is of others.
    """
    compiled = (
        function
        for function in ast.walk(ast.parse(text))
        if isinstance(function, ast.FunctionDef) and any("jit" in ast.unparse(d) for d in function.decorator_list)
    )
    return [
        assign.lineno
        for function in compiled
        for assign in ast.walk(function)
        if isinstance(assign, ast.Assign)
        for target in assign.targets
        if isinstance(target, ast.Tuple)
        and any(isinstance(part, ast.Subscript) and isinstance(part.value, ast.Attribute) for part in target.elts)
    ]


def test_no_kernel_unpacks_into_the_arrays_of_a_record():
    assert unpacked_into_fields("@njit\ndef f(a, k, pair):\n    a.x[k], a.y[k] = pair") == [3]
    assert unpacked_into_fields("@njit\ndef f(a, k, pair):\n    a.x[k] = pair[0]") == []
    found = {path: lines for path in SOURCE.rglob("*.py") if (lines := unpacked_into_fields(path.read_text()))}
    assert not found
