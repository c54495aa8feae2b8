/* The extension module: the kernels' Python functions. Each takes arrays by the buffer protocol and releases the GIL
   around long work; results of unknown length leave as bytes. */
#include "arguments.h"

static PyMethodDef methods[] = {
    {"gradient", call_gradient, METH_VARARGS, "gradient(image, bits, upper, magnitude) -> (anchors, orientation)"},
    {"chains", call_chains, METH_VARARGS, "chains(magnitude, anchors, orientation, lower, shortest) -> (pixels, starts)"},
    {"cuts", call_cuts, METH_VARARGS, "cuts(pixels, starts, deviation, share_change, window, shortest) -> pieces"},
    {"fits", call_fits, METH_VARARGS, "fits(magnitude, pixels, pieces, trim) -> (lines, moments)"},
    {"joins", call_joins, METH_VARARGS, "joins(lines, moments, pieces, gap, aside, shortest) -> (lines, support)"},
    {"stripes", call_stripes, METH_VARARGS,
     "stripes(image, dark, bands, taps, filters, params) -> (position, sigma, peak, piece)"},
    {"tracks", call_tracks, METH_VARARGS, "tracks(position, sigma, piece, laser, lens, params) -> tracks"},
    {"faces", call_faces, METH_VARARGS,
     "faces(tracks, unlabelled, planes, unions, candidates, ring) -> (tracks, groups of one, two and three)"},
    {"ends", call_ends, METH_VARARGS, "ends(images: (lit, dark, lines), lens, params) -> ends"},
    {"edge_places", call_edge_places, METH_VARARGS, "edge_places(arcs, covariance, lens, params) -> places"},
    {"edge_profiles", call_edge_profiles, METH_VARARGS,
     "edge_profiles(image, place, normal, params, value, saturated, noise): fills the last three"},
    {"edge_steps", call_edge_steps, METH_VARARGS,
     "edge_steps(value, saturated, noise, across, place, unit, table, params) -> steps"},
    {"render", call_render, METH_VARARGS,
     "render(target tables, poses, lamps, lasers, light, xy, per_px, width, pixels, samples, radiance, code, stripe): "
     "fills the last three"},
    {"hits", call_hits, METH_VARARGS,
     "hits(target tables, origin, direction, parameter, surface, point, normal): fills the last four"},
    {"code_edges", call_code_edges, METH_VARARGS, "code_edges(code with a border, edge): fills the last"},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_kernels", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernels(void) {
    fill_normal_cdf();
    return PyModule_Create(&definition);
}
