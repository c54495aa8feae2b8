/* The Python side of the kernels that look for the ring's face; arguments are checked here. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdlib.h>
#include <string.h>

#include "buffers.h"
#include "faces.h"

enum { TRACK_COLUMNS = sizeof(Track) / sizeof(double) };
enum { MOST_LASERS = 32, MOST_CANDIDATES = 1000, MOST_ROUNDS = 10 };

/* Whether the arrays fit together and tracks have lasers of the rig. */
static int in_order(const Py_buffer view[2], const FaceRules *rules) {
    const Track *track = view[0].buf;
    Py_ssize_t lasers = view[1].shape[0];
    double most = rules->candidates.most, rounds = rules->unions.rounds;
    if (view[0].shape[1] != TRACK_COLUMNS || view[1].shape[1] != 3 || lasers > MOST_LASERS ||
        view[0].shape[0] > INT32_MAX / 2 || !(most >= 1 && most <= MOST_CANDIDATES) ||
        !(rounds >= 0 && rounds <= MOST_ROUNDS)) {
        PyErr_SetString(PyExc_ValueError, "faces: arrays do not fit together, or a rule is out of range");
        return 0;
    }
    for (Py_ssize_t i = 0; i < view[0].shape[0]; i++) {
        if (track[i].laser >= -1 && track[i].laser < (double)lasers) continue;
        PyErr_Format(PyExc_ValueError, "tracks: number %zd is of a laser that is not of the rig", i);
        return 0;
    }
    return 1;
}

/* The tracks, then unions of them; and the best groups of all. */
typedef struct {
    List tracks;
    Candidate *candidate;
    Best best[MOST_MEMBERS];
} Found;

/* 0 if there is no memory. */
static int find(const Track *track, size_t count, const Scene *scene, Found *found) {
    List *all = &found->tracks;
    size_t room = (size_t)scene->lasers * (size_t)scene->rules->candidates.most;
    found->candidate = malloc((room ? room : 1) * sizeof *found->candidate);
    if (found->candidate == NULL || !reserve(all, count + 1)) return 0;
    if (count) memcpy(all->data, track, count * sizeof *track);
    all->used = count;
    if (!unite_collinear(track, count, &scene->rules->unions, all)) return 0;
    int candidates = find_candidates(all->data, all->used, all->used - count, scene, found->candidate);
    for (int size = 1; size <= MOST_MEMBERS; size++)
        found->best[size - 1] = best_group(found->candidate, candidates, size, scene);
    return 1;
}

/* Lasers and numbers of a group's tracks, its score, its rival's. */
static PyObject *group(const Found *found, int size) {
    const Best *best = &found->best[size - 1];
    int laser[MOST_MEMBERS], track[MOST_MEMBERS];
    for (int i = 0; i < size; i++) {
        laser[i] = best->index[0] < 0 ? -1 : found->candidate[best->index[i]].laser;
        track[i] = best->index[0] < 0 ? -1 : found->candidate[best->index[i]].track;
    }
    if (size == 1) return Py_BuildValue("((i)(i)dd)", laser[0], track[0], best->score, best->rival);
    if (size == 2)
        return Py_BuildValue("((ii)(ii)dd)", laser[0], laser[1], track[0], track[1], best->score, best->rival);
    return Py_BuildValue("((iii)(iii)dd)", laser[0], laser[1], laser[2], track[0], track[1], track[2], best->score,
                         best->rival);
}

static PyObject *faces_of(const Py_buffer view[2], unsigned unlabelled, const FaceRules *rules) {
    if (!in_order(view, rules)) return NULL;
    Scene scene = {(int)view[1].shape[0], unlabelled, (const double(*)[3])view[1].buf, rules};
    Found found = {.tracks = {NULL, 0, 0, sizeof(Track)}};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = find(view[0].buf, (size_t)view[0].shape[0], &scene, &found);
    Py_END_ALLOW_THREADS
    PyObject *result = NULL;
    if (done)
        result = Py_BuildValue("(y#(NNN))", found.tracks.data, (Py_ssize_t)(found.tracks.used * sizeof(Track)),
                               group(&found, 1), group(&found, 2), group(&found, 3));
    else
        PyErr_NoMemory();
    free(found.candidate);
    release(&found.tracks);
    return result;
}

/* The rules of unions, of candidates and of rings. */
static int read_rules(PyObject *const object[3], FaceRules *rules) {
    return read_numbers(object[0], "unions", (double *)&rules->unions, sizeof(UnionRules) / sizeof(double)) &&
           read_numbers(object[1], "candidates", (double *)&rules->candidates,
                        sizeof(CandidateRules) / sizeof(double)) &&
           read_numbers(object[2], "ring", (double *)&rules->ring, sizeof(RingRules) / sizeof(double));
}

static PyObject *faces(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[] = {{"tracks", "d", 2}, {"planes", "d", 2}};
    PyObject *o[2], *rules_object[3];
    unsigned unlabelled;
    Py_buffer view[2];
    FaceRules rules;
    if (!PyArg_ParseTuple(arguments, "OIO(OOO)", &o[0], &unlabelled, &o[1], &rules_object[0], &rules_object[1],
                          &rules_object[2]) ||
        !read_rules(rules_object, &rules) || !open_arrays(o, view, description, 2))
        return NULL;
    PyObject *result = faces_of(view, unlabelled, &rules);
    close_arrays(view, 2);
    return result;
}

static PyMethodDef methods[] = {
    {"faces", faces, METH_VARARGS, "Tracks and their unions, and the best groups of one, two and three."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_faces", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__faces(void) { return PyModule_Create(&module); }
