"""LSODA from SciPy on a problem of the bench: integrator_scipy.py LIBRARY INDEX RELATIVE RUNS -> a line of JSON.

SciPy's module holds the address of the Fortran routine; the library calls it, so that no Python runs while it
integrates."""
import ctypes
import json
import sys

from scipy.integrate import _lsoda


class Result(ctypes.Structure):
    _fields_ = [
        ("seconds", ctypes.c_double),
        ("y", ctypes.c_double * 32),
        ("rates", ctypes.c_long),
        ("jacobians", ctypes.c_long),
        ("steps", ctypes.c_long),
        ("state", ctypes.c_int),
    ]


def address_of(routine):
    capsule = routine._cpointer
    get_name = ctypes.pythonapi.PyCapsule_GetName
    get_name.restype, get_name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    get = ctypes.pythonapi.PyCapsule_GetPointer
    get.restype, get.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return get(capsule, get_name(capsule))


def main():
    library = ctypes.CDLL(sys.argv[1])
    solve = library.peer_solve
    solve.restype = None
    solve.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_double, ctypes.c_int, ctypes.POINTER(Result)]
    r = Result()
    solve(address_of(_lsoda.lsoda), int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4]), ctypes.byref(r))
    if r.state != 2:
        sys.exit("LSODA stopped with state %d" % r.state)
    print(json.dumps({"seconds": r.seconds, "y": list(r.y), "rates": r.rates, "jacobians": r.jacobians, "steps": r.steps}))


main()
