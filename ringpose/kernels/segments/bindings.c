/* The Python side of the line detector's kernels. */
#include "arguments.h"
#include "segments.h"

PyObject *call_gradient(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {
        {"image", 'I', {N, M}}, {"bits", 'L', {8, 16}}, {"upper", 'L', {1, INT16_MAX}}, {">magnitude", 'h', {N, M}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_buffer *image = &a.view[0];
    const int bits = (int)a.number[1][0];
    if (image->itemsize != (bits > 8 ? 2 : 1)) {
        PyErr_Format(PyExc_TypeError, "image: elements of %zd bytes do not hold %d bits", image->itemsize, bits);
        return close_arguments(&a, NULL);
    }
    const Image data = {image->buf, (size_t)image->shape[0], (size_t)image->shape[1], bits};
    Anchors anchors = {{NULL, 0, 0, sizeof(int32_t)}, {NULL, 0, 0, sizeof(uint8_t)}};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = find_gradient(&data, (int)a.number[2][0], a.view[3].buf, &anchors);
    Py_END_ALLOW_THREADS
    PyObject *result = Py_BuildValue("(NN)", list_bytes(done, &anchors.index), list_bytes(done, &anchors.orientation));
    return close_arguments(&a, result);
}

/* Whether every anchor is among the pixels that have a gradient. */
static int anchors_inside(const Py_buffer *magnitude, const Py_buffer *index) {
    const int32_t *anchor = index->buf;
    const int16_t *value = magnitude->buf;
    const uint32_t width = (uint32_t)magnitude->shape[1], height = (uint32_t)magnitude->shape[0];
    const uint32_t wide = width > 2 * MARGIN ? width - 2 * MARGIN : 0;
    const uint32_t high = height > 2 * MARGIN ? height - 2 * MARGIN : 0;
    for (Py_ssize_t i = 0; i < index->shape[0]; i++) {
        const uint32_t at = (uint32_t)anchor[i];
        if (at % width - MARGIN < wide && at / width - MARGIN < high && value[at] >= 0) continue;
        PyErr_Format(PyExc_ValueError, "anchors: number %zd has no gradient or a negative one", i);
        return 0;
    }
    return 1;
}

PyObject *call_chains(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{">magnitude", 'h', {ANY, ANY}},
                                          {"anchors", 'i', {N}},
                                          {"orientation", 'B', {N}},
                                          {"lower", 'L', {1, INT16_MAX}},
                                          {"shortest", 'L', {1, INT32_MAX}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    if (!anchors_inside(&a.view[0], &a.view[1])) return close_arguments(&a, NULL);
    const size_t anchors = (size_t)a.view[1].shape[0], shortest = (size_t)a.number[4][0];
    if (!anchors)
        return close_arguments(&a, Py_BuildValue("(y#y#)", "", (Py_ssize_t)0, "\0\0\0\0", (Py_ssize_t)4));
    const EdgeArea area = {a.view[0].buf, (size_t)a.view[0].shape[0], (size_t)a.view[0].shape[1], (int)a.number[3][0]};
    List pixels = {NULL, 0, 0, sizeof(Pixel)}, starts = {NULL, 0, 0, sizeof(int32_t)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = walk_chains(&area, a.view[1].buf, a.view[2].buf, anchors, shortest, &pixels, &starts);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, Py_BuildValue("(NN)", list_bytes(done, &pixels), list_bytes(done, &starts)));
}

static int starts_ascend(const Py_buffer *starts, Py_ssize_t pixels) {
    const int32_t *start = starts->buf;
    Py_ssize_t count = starts->shape[0];
    int ascend = count > 0 && start[0] >= 0 && start[count - 1] <= pixels && pixels <= INT32_MAX;
    for (Py_ssize_t i = 1; ascend && i < count; i++) ascend = start[i - 1] <= start[i];
    return require(ascend, "starts: must ascend from 0 or more to at most the number of pixels");
}

PyObject *call_cuts(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"pixels", 'i', {ANY, 2}},       {"starts", 'i', {ANY}},
                                          {"deviation", 'R', {0}},         {"share_change", 'R', {0}},
                                          {"window", 'L', {2, INT32_MAX}}, {"shortest", 'L', {2, INT32_MAX}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    if (!starts_ascend(&a.view[1], a.view[0].shape[0])) return close_arguments(&a, NULL);
    const CutRules rules = {a.number[2][0], a.number[3][0], (size_t)a.number[4][0], (size_t)a.number[5][0]};
    List pieces = {NULL, 0, 0, sizeof(Piece)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = cut_chains(a.view[0].buf, a.view[1].buf, (size_t)a.view[1].shape[0] - 1, rules, &pieces);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, list_bytes(done, &pieces));
}

static int pieces_inside(const Py_buffer *pieces, Py_ssize_t pixels) {
    const Piece *piece = pieces->buf;
    for (Py_ssize_t i = 0; i < pieces->shape[0]; i++) {
        if (piece[i].first >= 0 && piece[i].first <= piece[i].last && piece[i].last < pixels) continue;
        PyErr_Format(PyExc_ValueError, "pieces: number %zd is not within the pixels", i);
        return 0;
    }
    return 1;
}

PyObject *call_fits(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"magnitude", 'h', {ANY, ANY}},
                                          {"pixels", 'i', {ANY, 2}},
                                          {"pieces", 'i', {ANY, 2}},
                                          {"trim", 'L', {0, INT32_MAX}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    if (!pieces_inside(&a.view[2], a.view[1].shape[0])) return close_arguments(&a, NULL);
    const Magnitude area = {a.view[0].buf, (size_t)a.view[0].shape[0], (size_t)a.view[0].shape[1]};
    const size_t count = (size_t)a.view[2].shape[0], trim = (size_t)a.number[3][0];
    List lines = {NULL, 0, 0, sizeof(Line)}, moments = {NULL, 0, 0, sizeof(Moments)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = fit_pieces(&area, a.view[1].buf, a.view[2].buf, count, trim, &lines, &moments);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, Py_BuildValue("(NN)", list_bytes(done, &lines), list_bytes(done, &moments)));
}

PyObject *call_joins(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"lines", 'd', {N, 4}}, {"moments", 'd', {N, 6}},
                                          {"pieces", 'i', {N, 2}}, {"gap", 'R', {0}},
                                          {"aside", 'R', {0}},    {"shortest", 'L', {0, INT32_MAX}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const JoinRules rules = {a.number[3][0], a.number[4][0], (int64_t)a.number[5][0]};
    if (!require(rules.gap >= 0 && rules.gap < 1e6 && rules.aside > 0 && rules.aside < 1e6,
                 "gap, aside: must be 0 to 1e6, and aside more than 0"))
        return close_arguments(&a, NULL);
    List joined = {NULL, 0, 0, sizeof(Line)}, support = {NULL, 0, 0, sizeof(int64_t)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = join_lines(a.view[0].buf, a.view[1].buf, a.view[2].buf, (size_t)a.view[0].shape[0], rules, &joined,
                      &support);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, Py_BuildValue("(NN)", list_bytes(done, &joined), list_bytes(done, &support)));
}
