/*
The hot loops in C: the same equations as the NumPy code they stand in for, one measurement or one
interval at a time. geograph/kernels/__init__.py names them, and says which Python code is the
reference; tests/test_kernels.py holds both together.

Arrays come through the buffer protocol, C-contiguous, float64 or int64; their sizes are checked
here, their meaning in Python. Only the limited API is used: one build serves every Python from
3.11 on.
*/
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030b0000
#include <Python.h>

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* The same source for processors with wide registers and for those without, told apart by what they
   can do and not by who made them (arch=haswell would be Intel's alone). */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__linux__)
#if __GNUC__ >= 12
#define WIDE __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define WIDE __attribute__((target_clones("avx2", "default")))
#endif
#else
#define WIDE
#endif

#if defined(__GNUC__) || defined(__clang__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

typedef Py_ssize_t Size;

/* One after the other, each standing on those before: one unit, so that all may be inlined. */
#include "arrays.h"
#include "matrices.h"
#include "sweep.h"
#include "blocks.h"
#include "bearings.h"
#include "motion.h"
#include "live.h"
#include "radio.h"

static PyMethodDef methods[] = {
    {"sweep", (PyCFunction)(void (*)(void))sweep, METH_FASTCALL, "geograph.sweep.sweep"},
    {"marginals", (PyCFunction)(void (*)(void))marginals, METH_FASTCALL,
     "geograph.sweep.chain_marginals"},
    {"substitute", (PyCFunction)(void (*)(void))substitute, METH_FASTCALL,
     "The back substitution of geograph.eliminate.Factorisation.solve"},
    {"substitute_later", (PyCFunction)(void (*)(void))substitute_later, METH_FASTCALL,
     "geograph.sweep.Ends.substitute"},
    {"turn_back", (PyCFunction)(void (*)(void))turn_back_later, METH_FASTCALL,
     "geograph.sweep.Ends.turned_back"},
    {"add_blocks", (PyCFunction)(void (*)(void))add_blocks, METH_FASTCALL,
     "geograph.blocks.BlockSum.add"},
    {"bearings", (PyCFunction)(void (*)(void))bearings, METH_FASTCALL,
     "geograph.families.bearings.BearingFamily.evaluate"},
    {"kinematics", (PyCFunction)(void (*)(void))kinematics, METH_FASTCALL,
     "geograph.motion.Motion.linear"},
    {"fall", (PyCFunction)(void (*)(void))fall, METH_FASTCALL,
     "geograph.factors.gravity.propagate"},
    {"sound_bearings", (PyCFunction)(void (*)(void))sound_bearings, METH_FASTCALL,
     "The checks of geograph.incremental.rows.read"},
    {"departures", (PyCFunction)(void (*)(void))departures, METH_FASTCALL,
     "geograph.incremental.room.emission_times"},
    {"live_interval", (PyCFunction)(void (*)(void))live_interval, METH_FASTCALL,
     "geograph.incremental.model.Model.linearise, of one interval"},
    {"live_eliminate", (PyCFunction)(void (*)(void))live_eliminate, METH_FASTCALL,
     "geograph.sweep.sweep, of one interval"},
    {"live_finish", (PyCFunction)(void (*)(void))live_finish, METH_FASTCALL,
     "The end of geograph.incremental.chain.Chain.eliminate"},
    {"live_covariance", (PyCFunction)(void (*)(void))live_covariance, METH_FASTCALL,
     "geograph.incremental.chain.Final.covariance"},
    {"live_place", (PyCFunction)(void (*)(void))live_place, METH_FASTCALL,
     "geograph.incremental.chain.Chain.solve, of one knot"},
    {"live_moved", (PyCFunction)(void (*)(void))live_moved, METH_FASTCALL,
     "geograph.incremental.curvature.Limits.moved, of one interval"},

    {"radio_plan", (PyCFunction)(void (*)(void))radio_plan, METH_FASTCALL,
     "What the two that follow need and no solve changes"},
    {"radio", (PyCFunction)(void (*)(void))radio, METH_FASTCALL,
     "geograph.families.rays.RayFamily.evaluate"},
    {"radio_sums", (PyCFunction)(void (*)(void))radio_sums, METH_FASTCALL,
     "The same with geograph.common.settled and geograph.blocks.BlockSum.add"},
    {"settle", (PyCFunction)(void (*)(void))settle, METH_FASTCALL, "geograph.common.settled"},
    {"add_shared", (PyCFunction)(void (*)(void))add_shared, METH_FASTCALL,
     "geograph.blocks.BlockSum.add, of measurements that share unknowns"},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_compiled", "The hot loops in C.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__compiled(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made == NULL)
        return NULL;
    const struct {
        const char *name;
        long value;
    } channels[] = {{"AZIMUTH", AZIMUTH},   {"ELEVATION", ELEVATION}, {"CLOCK", CLOCK},
                    {"POSITION", POSITION}, {"VELOCITY", VELOCITY},   {"SPEED", SPEED},
                    {"FREQUENCY", FREQUENCY}, {"CHANNELS", CHANNELS}};
    for (size_t i = 0; i < sizeof channels / sizeof channels[0]; i++)
        if (PyModule_AddIntConstant(made, channels[i].name, channels[i].value) < 0) {
            Py_DECREF(made);
            return NULL;
        }
    return made;
}
