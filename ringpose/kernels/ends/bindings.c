/* The Python side of where stripes end. */
#include <stdlib.h>

#include "arguments.h"
#include "ends.h"
#include "marks.h"

PyObject *call_ends(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"lit", 'I', {N, M}},
                                          {"?dark", 'I', {N, M}},
                                          {"lines", 'd', {ANY, NUMBERS(StripeLine)}},
                                          {"lens", 'T', {NUMBERS(Lens)}},
                                          {"rules", 'T', {NUMBERS(EndRules)}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_buffer *lit = &a.view[0], *dark = a.view[1].obj ? &a.view[1] : NULL;
    if (dark && dark->itemsize != lit->itemsize) {
        PyErr_SetString(PyExc_TypeError, "dark: must be of the same type as lit");
        return close_arguments(&a, NULL);
    }
    Images images = {lit->buf, dark ? dark->buf : NULL, lit->shape[0], lit->shape[1], lit->itemsize == 2};
    const size_t lines = (size_t)a.view[2].shape[0], bytes = 2 * lines * sizeof(StripeEnd);
    StripeEnd *end = malloc(bytes ? bytes : 1);
    int done = 0;
    Py_BEGIN_ALLOW_THREADS
    done = end && stripe_ends(&images, a.view[2].buf, lines, (const Lens *)a.number[3], (const EndRules *)a.number[4],
                              end);
    Py_END_ALLOW_THREADS
    PyObject *result = done ? PyBytes_FromStringAndSize((const char *)end, (Py_ssize_t)bytes) : PyErr_NoMemory();
    free(end);
    return close_arguments(&a, result);
}

static int lasers_of_rig(const int64_t *laser, Py_ssize_t tracks, Py_ssize_t lasers) {
    for (Py_ssize_t i = 0; i < tracks; i++) {
        if (laser[i] >= 0 && laser[i] < lasers) continue;
        PyErr_Format(PyExc_ValueError, "lasers: number %zd is not of the rig", i);
        return 0;
    }
    return 1;
}

PyObject *call_marks(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"tracks", 'd', {N, NUMBERS(Track)}},
                                          {"ends", 'd', {N, 2, NUMBERS(StripeEnd)}},
                                          {"lasers", 'q', {N}},
                                          {"rules", 'T', {NUMBERS(MarkRules)}},
                                          {">position", 'd', {M, 2, 2}},
                                          {">covariance", 'd', {M, 2, 2, 2}},
                                          {">flags", 'q', {M, 2}},
                                          {">straight", 'd', {M, 2, 2}},
                                          {">sigma", 'd', {M, 2}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_ssize_t tracks = a.view[0].shape[0];
    const int64_t *laser = a.view[2].buf;
    const Track *track = a.view[0].buf;
    const StripeEnd *end = a.view[1].buf;
    Marks marks = {a.view[4].shape[0], a.view[4].buf, a.view[5].buf, a.view[6].buf, a.view[7].buf, a.view[8].buf};
    if (!lasers_of_rig(laser, tracks, marks.lasers)) return close_arguments(&a, NULL);
    clear_marks(&marks);
    for (Py_ssize_t i = 0; i < tracks; i++)
        mark_ends(&track[i], &end[2 * i], (ptrdiff_t)laser[i], (const MarkRules *)a.number[3], &marks);
    return close_arguments(&a, Py_BuildValue(""));
}
