/* The extension module: the kernels' Python functions. Each takes arrays by the buffer protocol and releases the GIL
   around long work; results of unknown length leave as bytes. */
#include "arguments.h"
#include "ends/end_edges.h"
#include "lines/stripe_segments.h"
#include "render/target.h"
#include "segments/segments.h"
#include "stripes/stripe_search.h"

/* The functions, and what they take and return. Each is defined beside its loops. */
#define KERNELS(KERNEL)                                                                                             \
    KERNEL(gradient, "(image, bits, upper, magnitude) -> (anchors, orientation)")                                   \
    KERNEL(chains, "(magnitude, anchors, orientation, lower, shortest) -> (pixels, starts)")                        \
    KERNEL(cuts, "(pixels, starts, deviation, share_change, window, shortest) -> pieces")                           \
    KERNEL(fits, "(magnitude, pixels, pieces, trim) -> (lines, moments)")                                           \
    KERNEL(joins, "(lines, moments, pieces, gap, aside, shortest) -> (lines, support)")                             \
    KERNEL(stripes, "(image, dark, bands, taps, filters, params) -> (position, sigma, peak, piece)")                \
    KERNEL(stripe_segments, "(position, sigma, piece, laser, lens, params) -> segments")                            \
    KERNEL(arcs, "(points, arc, arcs): fills the last")                                                             \
    KERNEL(faces, "(segments, unlabelled, planes, unions, candidates, ring) -> (segments, groups of 1, 2 and 3)")       \
    KERNEL(ends, "(images: (lit, dark, lines), lens, params) -> ends")                                              \
    KERNEL(edge_places, "(point, off_face, sign, number, normal, wrt_step, covariance, lens, params) -> places")              \
    KERNEL(edge_profiles, "(image, place, normal, params, value, saturated, noise): fills the last three")          \
    KERNEL(edge_steps, "(value, saturated, noise, across, place, unit, table, params) -> steps")                    \
    KERNEL(render, "(target tables, poses, lamps, lasers, light, xy, per_px, width, pixels, samples, step, radiance, " \
                   "code, stripe): fills the last three")                                                           \
    KERNEL(hits, "(target tables, origin, direction, parameter, surface, point, normal): fills the last four")      \
    KERNEL(code_edges, "(code with a border, edge): fills the last")

#define PROTOTYPE(name, doc) PyObject *call_##name(PyObject *module, PyObject *tuple);
#define METHOD(name, doc) {#name, call_##name, METH_VARARGS, #name doc},

KERNELS(PROTOTYPE)

static PyMethodDef methods[] = {KERNELS(METHOD){NULL, NULL, 0, NULL}};

/* The records of parameters (kernels.h), each defined beside the loops that it is for. */
#define RECORDS(RECORD)                                                                                             \
    RECORD(Lens) RECORD(StripeParams) RECORD(SegmentParams) RECORD(UnionParams) RECORD(CandidateParams)               \
    RECORD(RingParams) RECORD(EndParams) RECORD(PlaceParams) RECORD(ProfileParams) RECORD(StepParams)               \
    RECORD(SceneLight)

#define DECLARATION(type) extern const Kind type##_record;
#define ADDRESS(type) &type##_record,

RECORDS(DECLARATION)

static const Kind *const records[] = {RECORDS(ADDRESS)};

#define TABLES(TABLE) TABLE(Segment) TABLE(StripeLine) TABLE(StripeEnd) TABLE(Place) TABLE(EdgeStep) TABLE(Arcs)

#define TABLE_DECLARATION(type) extern const Table type##_table;
#define TABLE_ADDRESS(type) &type##_table,

TABLES(TABLE_DECLARATION)

static const Table *const tables[] = {TABLES(TABLE_ADDRESS)};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_kernels", NULL, -1, methods, NULL, NULL, NULL, NULL};

/* Adds an object to the module, or NULL and a Python exception; returns the module or NULL. */
static PyObject *with(PyObject *module, const char *name, PyObject *object) {
    const int done = module && object && PyModule_AddObjectRef(module, name, object) == 0;
    Py_XDECREF(object);
    if (done) return module;
    Py_XDECREF(module);
    return NULL;
}

/* Numbers that Python needs, too. */
#define CONSTANTS(NUMBER)                                                                                           \
    NUMBER(MAX_CUT) NUMBER(COLUMNS_PER_CUT) NUMBER(BLOCK) NUMBER(CELL) NUMBER(STEPS_PER_DN) NUMBER(EMPTY) NUMBER(THIN) \
    NUMBER(BOX) NUMBER(REVOLUTION) NUMBER(RELIEF_TEXELS) NUMBER(MAX_PARTS) NUMBER(MAX_POINTS) NUMBER(MAX_LASERS)
#define ADD_NUMBER(name) \
    if (module) module = with(module, #name, PyLong_FromLong(name));

PyMODINIT_FUNC PyInit__kernels(void) {
    fill_normal_cdf();
    PyObject *module = PyModule_Create(&definition);
    if (module) module = with(module, "RECORDS", declared_records(records, sizeof records / sizeof *records));
    if (module) module = with(module, "TABLES", declared_tables(tables, sizeof tables / sizeof *tables));
    CONSTANTS(ADD_NUMBER)
    return module;
}
