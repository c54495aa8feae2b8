/* Reflection by coatings, and their patterns. */
#include "target.h"

#define PI 3.14159265358979323846

/* Minimum roughness: a smoother surface would reflect a projector as a point. */
static const double MIN_ROUGHNESS = 0.02;

/* Lambert plus GGX with Smith shadowing and the Fresnel term of Schlick; directions are unit vectors. */
double reflectance(Coating coating, Vector normal, Vector to_light, Vector to_eye) {
    const double lambert = coating.diffuse / PI;
    if (coating.specular <= 0) return lambert;
    const Vector sum = plus(to_light, to_eye), half = times(1 / greater(sqrt(dot(sum, sum)), 1e-9), sum);
    const double n_half = greater(dot(normal, half), 1e-4), n_light = greater(dot(normal, to_light), 1e-4);
    const double n_eye = greater(dot(normal, to_eye), 1e-4), alpha = greater(coating.roughness, MIN_ROUGHNESS);
    const double alpha2 = alpha * alpha, lobe = n_half * n_half * (alpha2 - 1) + 1;
    const double grazing = 1 - lesser(greater(dot(half, to_eye), 0), 1), grazing2 = grazing * grazing;
    const double fresnel = coating.specular + (1 - coating.specular) * grazing2 * grazing2 * grazing;
    const double smith = (n_light + sqrt(alpha2 + (1 - alpha2) * n_light * n_light)) *
                         (n_eye + sqrt(alpha2 + (1 - alpha2) * n_eye * n_eye));
    return lambert + alpha2 * fresnel / (PI * lobe * lobe * smith);
}

/* Length of lines [k cell, k cell + line] between 0 and x, for any x. */
static double lines_until(double x, double cell, double line) {
    const double number = (double)whole(x / cell);
    return number * line + lesser(x - number * cell, line);
}

static double line_share(double x, double cell, double line, double width) {
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

static double mixed(double first, double second, double share) { return first + share * (second - first); }

Coating coating_at(const Target *target, const Hit *hit, double footprint, int *second) {
    const Material *material = target->material + target->material_of[hit->surface];
    Coating coating = material->coating;
    *second = 0;
    if (material->printed > 0) {
        const int column = interval(target->print_x, target->columns - 1, hit->u);
        const int row = interval(target->print_y, target->rows - 1, hit->v);
        *second = target->print[row * target->columns + column];
        if (*second) coating = material->second;
    } else if (material->cell_x > 0) {
        const double width = greater(footprint, 1e-9);
        const double along_u = line_share(hit->u, material->cell_x, material->line, width);
        const double share = 1 - (1 - along_u) * (1 - line_share(hit->v, material->cell_y, material->line, width));
        coating.diffuse = mixed(coating.diffuse, material->second.diffuse, share);
        coating.specular = mixed(coating.specular, material->second.specular, share);
        coating.roughness = mixed(coating.roughness, material->second.roughness, share);
    }
    return coating;
}
