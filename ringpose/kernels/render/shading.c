/* Coatings of surfaces, and their patterns. */
#include "target.h"

/* Length of lines [k cell, k cell + line] between 0 and x, for any x. */
static inline double lines_until(double x, double cell, double line) {
    const double number = whole(x / cell);
    return number * line + lesser(x - number * cell, line);
}

static inline double line_share(double x, double cell, double line, double width) {
    return (lines_until(x + width / 2, cell, line) - lines_until(x - width / 2, cell, line)) / width;
}

/* Number of lines that are not above x. */
static int interval(const double *line, int count, double x) {
    int low = 0, high = count;
    while (low < high) {
        const int middle = (low + high) / 2;
        if (line[middle] <= x)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static float mixed(double first, double second, double share) { return (float)(first + share * (second - first)); }

/* Coatings of one material with a pattern. */
static void find_patterned(const Target *target, const Material *material, const double width[BATCH], int first, int last,
                           Hits *hits) {
    for (int i = first; i < last; i++) {
        const Coating *coating = &material->coating;
        double share = 0;
        if (material->printed > 0) {
            const int column = interval(target->print_x, target->columns - 1, hits->u[i]);
            const int row = interval(target->print_y, target->rows - 1, hits->v[i]);
            hits->second[i] = target->print[row * target->columns + column];
            if (hits->second[i]) coating = &material->second;
        } else {
            const double square = greater(width[i], 1e-9);
            const double along_u = line_share(hits->u[i], material->cell_x, material->line, square);
            share = 1 - (1 - along_u) * (1 - line_share(hits->v[i], material->cell_y, material->line, square));
        }
        hits->diffuse[i] = mixed(coating->diffuse, material->second.diffuse, share);
        hits->specular[i] = mixed(coating->specular, material->second.specular, share);
        hits->roughness[i] = mixed(coating->roughness, material->second.roughness, share);
    }
}

void find_coatings(const Target *target, const double width[BATCH], Hits *hits) {
    for (int first = 0, last; first < hits->count; first = last) {
        const Material *material = target->material + target->material_of[hits->surface[first]];
        const Coating *coating = &material->coating;
        for (last = first + 1; last < hits->count && hits->surface[last] == hits->surface[first];) last++;
        for (int i = first; i < last; i++) {
            hits->second[i] = 0;
            hits->diffuse[i] = (float)coating->diffuse;
            hits->specular[i] = (float)coating->specular;
            hits->roughness[i] = (float)coating->roughness;
        }
        if (material->printed > 0 || material->cell_x > 0) find_patterned(target, material, width, first, last, hits);
    }
}
