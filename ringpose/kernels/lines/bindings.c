/* The Python side of tracks, of which of them lie on the ring, and of arcs through their ends. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "arguments.h"
#include "arcs.h"
#include "faces.h"

/* Whether all centres are finite, their pieces ascend from 0, and every piece has a laser. */
static int centers_in_order(const Py_buffer view[4]) {
    const double(*at)[2] = view[0].buf, *sigma = view[1].buf;
    const int64_t *piece = view[2].buf;
    for (Py_ssize_t i = 0; i < view[0].shape[0]; i++) {
        int in_order = piece[i] >= (i ? piece[i - 1] : 0) && piece[i] < view[3].shape[0];
        if (in_order && isfinite(at[i][0]) && isfinite(at[i][1]) && isfinite(sigma[i])) continue;
        PyErr_Format(PyExc_ValueError, "centers: number %zd is not finite, or its piece is out of order", i);
        return 0;
    }
    return 1;
}

enum { TRACK_RULES = 8, MIN_COLUMNS = 4 };

/* A piece must hold the running median's half window, or that reads beyond it. */
static int track_rules_fit(const double rule[TRACK_RULES]) {
    int fit = rule[5] >= MIN_COLUMNS && rule[6] >= 1 && rule[6] < 1e6 && rule[7] >= 0;
    for (int i = 0; i < TRACK_RULES; i++) fit = fit && isfinite(rule[i]);
    return require(fit, "rules: a rule of tracks is out of range");
}

static Track *find_tracks(const Py_buffer view[4], const Lens *lens, const double rule[TRACK_RULES], size_t *count) {
    const size_t n = (size_t)view[0].shape[0];
    const double(*at)[2] = view[0].buf;
    double *column = malloc((n ? 3 * n : 1) * sizeof *column);
    if (column == NULL) return NULL;
    double *x = column + n, *y = x + n;
    for (size_t i = 0; i < n; i++) {
        column[i] = x[i] = at[i][0];
        y[i] = at[i][1];
    }
    undistort(lens, x, y, n);
    Centers centers = {n, (size_t)view[3].shape[0], column, x, y, view[1].buf, view[2].buf, view[3].buf};
    TrackRules rules = {rule[0], rule[1], rule[2], rule[3], rule[4], (size_t)rule[5], (size_t)rule[7], rule[6]};
    Track *track = straight_tracks(&centers, &rules, count);
    free(column);
    return track;
}

PyObject *call_tracks(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"position", 'd', {N, 2}}, {"sigma", 'd', {N}},
                                          {"piece", 'q', {N}},       {"laser", 'q', {ANY}},
                                          {"lens", 'T', {NUMBERS(Lens)}}, {"rules", 'T', {TRACK_RULES}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    if (!track_rules_fit(a.number[5]) || !centers_in_order(a.view)) return close_arguments(&a, NULL);
    Track *track;
    size_t count = 0;
    Py_BEGIN_ALLOW_THREADS
    track = find_tracks(a.view, (const Lens *)a.number[4], a.number[5], &count);
    Py_END_ALLOW_THREADS
    PyObject *result =
        track ? PyBytes_FromStringAndSize((const char *)track, (Py_ssize_t)(count * sizeof *track)) : PyErr_NoMemory();
    free(track);
    return close_arguments(&a, result);
}

enum { MAX_LASERS = 32, MAX_CANDIDATES = 1000, MAX_ROUNDS = 10 };

static int lasers_of_rig(const Track *track, Py_ssize_t tracks, Py_ssize_t lasers) {
    for (Py_ssize_t i = 0; i < tracks; i++) {
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
    PyObject *lasers = PyTuple_New(size), *tracks = PyTuple_New(size);
    for (int i = 0; lasers && tracks && i < size; i++) {
        const Candidate *candidate = best->index[0] < 0 ? NULL : &found->candidate[best->index[i]];
        PyTuple_SetItem(lasers, i, PyLong_FromLong(candidate ? candidate->laser : -1));
        PyTuple_SetItem(tracks, i, PyLong_FromLong(candidate ? candidate->track : -1));
    }
    return Py_BuildValue("(NNdd)", lasers, tracks, best->score, best->rival);
}

PyObject *call_faces(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"tracks", 'd', {ANY, NUMBERS(Track)}},
                                          {"unlabelled", 'L', {0, INT32_MAX}},
                                          {"planes", 'd', {ANY, 3}},
                                          {"unions", 'T', {NUMBERS(UnionRules)}},
                                          {"candidates", 'T', {NUMBERS(CandidateRules)}},
                                          {"ring", 'T', {NUMBERS(RingRules)}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    FaceRules rules;
    memcpy(&rules.unions, a.number[3], sizeof rules.unions);
    memcpy(&rules.candidates, a.number[4], sizeof rules.candidates);
    memcpy(&rules.ring, a.number[5], sizeof rules.ring);
    const Py_ssize_t tracks = a.view[0].shape[0], lasers = a.view[2].shape[0];
    if (!require(lasers <= MAX_LASERS && tracks <= INT32_MAX / 2, "planes, tracks: there are too many") ||
        !require(rules.candidates.most >= 1 && rules.candidates.most <= MAX_CANDIDATES && rules.unions.rounds >= 0 &&
                     rules.unions.rounds <= MAX_ROUNDS,
                 "rules: a rule of faces is out of range") ||
        !lasers_of_rig(a.view[0].buf, tracks, lasers))
        return close_arguments(&a, NULL);
    Scene scene = {(int)lasers, (unsigned)a.number[1][0], (const double(*)[3])a.view[2].buf, &rules};
    Found found = {.tracks = {NULL, 0, 0, sizeof(Track)}};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = find(a.view[0].buf, (size_t)tracks, &scene, &found);
    Py_END_ALLOW_THREADS
    PyObject *bytes = list_bytes(done, &found.tracks);
    PyObject *result =
        bytes ? Py_BuildValue("(N(NNN))", bytes, group(&found, 1), group(&found, 2), group(&found, 3)) : NULL;
    free(found.candidate);
    return close_arguments(&a, result);
}

/* Where ends were seen, as points on their arcs; `number` tells which they are. Returns how many. */
typedef struct {
    double place[MOST_ENDS][2], light[MOST_ENDS][4];
    End end[MOST_ENDS];
    int number[MOST_ENDS], arc[2];
} SeenEnds;

static int find_seen(const Py_buffer view[3], SeenEnds *seen) {
    const double(*position)[2] = view[0].buf, (*covariance)[4] = view[1].buf, (*plane)[4] = view[2].buf;
    int count = 0, all = 2 * (int)view[0].shape[0];
    seen->arc[0] = seen->arc[1] = 0;
    for (int k = 0; k < all; k++) {
        if (isnan(position[k][0])) continue;
        memcpy(seen->place[count], position[k], sizeof position[k]);
        memcpy(seen->light[count], plane[k / 2], sizeof plane[0]);
        seen->end[count] = (End){.arc = k % 2, .used = 1, .along_sigma = sqrt(covariance[k][0])};
        seen->number[count++] = k;
        seen->arc[k % 2]++;
    }
    return count;
}

/* Sigmas in metres: along x and, with that of the circles, across. */
static void scale_sigmas(SeenEnds *seen, int count, double circle_sigma, int exact) {
    for (int i = 0; i < count; i++) {
        double metres = seen->end[i].sigma, *along = &seen->end[i].along_sigma;
        *along = metres * (count <= exact ? hypot(*along, circle_sigma) : *along);
        seen->end[i].sigma = hypot(*along, circle_sigma * metres);
    }
}

PyObject *call_arcs(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"position", 'd', {N, 2, 2}}, {"covariance", 'd', {N, 2, 2, 2}},
                                          {"planes", 'd', {N, 4}},      {"lens", 'T', {NUMBERS(Lens)}},
                                          {"circle_sigma", 'R', {0}},   {"exact", 'L', {0, INT32_MAX}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_ssize_t lasers = a.view[0].shape[0];
    if (!require(lasers <= MOST_ENDS / 2, "position: there are too many lasers")) return close_arguments(&a, NULL);
    SeenEnds seen;
    double cost[MOST_ENDS + 3], without[MOST_ENDS];
    int count = find_seen(a.view, &seen);
    flatten_ends(seen.place[0], seen.light[0], (const Lens *)a.number[3], seen.end, count);
    scale_sigmas(&seen, count, a.number[4][0], (int)a.number[5][0]);
    arc_costs(seen.end, count, cost);
    for (Py_ssize_t k = 0; k < 2 * lasers; k++) without[k] = INFINITY;
    for (int i = 0; i < count; i++) without[seen.number[i]] = cost[i + 1];
    PyObject *list = PyTuple_New(2 * lasers);
    for (Py_ssize_t k = 0; list && k < 2 * lasers; k++) PyTuple_SetItem(list, k, PyFloat_FromDouble(without[k]));
    return close_arguments(
        &a, Py_BuildValue("((ii)dNdd)", seen.arc[0], seen.arc[1], cost[0], list, cost[count + 1], cost[count + 2]));
}
