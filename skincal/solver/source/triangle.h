/* The point of a triangle nearest to the origin, in closed form; and the optimum on it once more, in small numbers.
 *
 * The closed form holds for needles and for triangles without area, which a metric that does not see one direction makes of
 * good ones. The interior point comes from an orthogonalised pair of edges, longest first (error: rounding times length
 * over height, where the usual determinant formula squares the ratio); each edge's point from a clamped projection. The
 * best of the four is taken by its true distance, so a badly determined interior point can never win wrongly.
 */
#ifndef TRIANGLE_H
#define TRIANGLE_H

#include "base.h"
#include "tables.h"

/* A squared length below this is zero, as is whatever is divided by it. */
static const double NO_LENGTH = 1e-300;

static const int AFTER[3] = {1, 2, 0}, BEFORE[3] = {2, 0, 1};

/* A point of a triangle: of corner `first` the share 1 - u - v, of the next u, of the one before v. */
typedef struct { double squared, u, v; int first; } Closest;

static Closest closest_on_edges(const Vec c[3], const Vec e[3], double starts[3])
{
    Closest best = {INFINITE, 0, 0, 0};
    for (int j = 0; j < 3; j++) {
        starts[j] = -dot(c[j], e[j]) / larger(dot(e[j], e[j]), NO_LENGTH);
        double along = smaller(larger(starts[j], 0.0), 1.0);
        Vec on = plus(times(along, e[j]), c[j]);
        double squared = dot(on, on);
        if (squared < best.squared) best = (Closest){squared, along, 0, j};
    }
    return best;
}

static Closest closest_to_origin(const Vec c[3])
{
    Vec e[3] = {minus(c[1], c[0]), minus(c[2], c[1]), minus(c[0], c[2])};
    double starts[3], lengths[3] = {dot(e[0], e[0]), dot(e[1], e[1]), dot(e[2], e[2])};
    Closest edge = closest_on_edges(c, e, starts);
    int k = lengths[2] > larger(lengths[0], lengths[1]) ? 2 : lengths[1] > lengths[0] ? 1 : 0;
    double size = larger(lengths[k], NO_LENGTH);
    Vec along = e[k], aside = times(-1.0, e[BEFORE[k]]);
    double tilt = dot(aside, along) / size;
    aside = minus(aside, times(tilt, along));
    /* Once more, since the first pass leaves rounding of the long edge's size. */
    double again = dot(aside, along) / size;
    aside = minus(aside, times(again, along));
    tilt += again;
    double height = dot(aside, aside);
    Vec foot = plus(times(starts[k], along), c[k]);
    double v = -dot(foot, aside) / larger(height, NO_LENGTH), u = starts[k] - v * tilt;
    if (u < 0 || v < 0 || u + v > 1 || !(height > 0)) return edge;
    Vec inside = plus(times(v, aside), foot);
    double squared = dot(inside, inside);
    return squared <= edge.squared ? (Closest){squared, u, v, k} : edge;
}

/* Corner by corner in their own order, so that two triangles find the same bits for a corner that they share. */
INLINE Vec point_of(const Closest *found, const Vec corners[3])
{
    double shares[3];
    shares[found->first] = 1.0 - found->u - found->v;
    shares[AFTER[found->first]] = found->u;
    shares[BEFORE[found->first]] = found->v;
    return plus(plus(times(shares[0], corners[0]), times(shares[1], corners[1])), times(shares[2], corners[2]));
}

/* ---- the optimum about an anchor that is nearly it ----
 *
 * Images of whole triangles carry the rounding of their size, in a metric's heavy rows as well; where the metric hardly
 * sees a direction, that rounding decides. About an anchor the numbers are as small as what is left to move: with
 * p = anchor + d,
 *
 *     |root p - offset|^2 = |rest|^2 + f(d),   f(d) = sum_i w_i (2 rest_i + w_i),   w = root d,   rest = root anchor - offset,
 *
 * and the rounding of `rest` is the same for all triangles, like a change of the offset's last digit. So f tells apart what
 * the distances cannot. In the plane of a triangle d follows from two columns, by a reflection from their largest element:
 * rows of very different size keep their digits (Cox and Higham 1998).
 */

typedef struct {
    Vec away;      /* d, metres */
    int corner;    /* where the point is one, else -1 */
    double rise;   /* f(d): below zero where the anchor was not the best */
    double unsure; /* the rounding of `rise` */
} Polished;

/* Minimises |s g + t k + h|; not finite where g and k are dependent. */
static void two_columns(Vec g, Vec k, Vec h, double *s, double *t)
{
    int swap = dot(k, k) > dot(g, g);
    if (swap) { Vec other = g; g = k; k = other; }
    double *column = &g.x;
    int lead = size_of(g.y) > size_of(g.x) ? 1 : 0;
    if (size_of(g.z) > size_of(column[lead])) lead = 2;
    double first = column[lead], size = signed_as(length(g), first);
    column[lead] += size;
    Vec beta = vec(g.x / (size * (first + size)), g.y / (size * (first + size)), g.z / (size * (first + size)));
    k = minus(k, times(dot(g, k), beta));
    h = minus(h, times(dot(g, h), beta));
    double above = k.at[lead], right = h.at[lead];
    k.at[lead] = 0.0;
    double y = -dot(k, h) / dot(k, k), x = (right + above * y) / size;
    *s = swap ? y : x;
    *t = swap ? x : y;
}

/* The best point of the plane; whether it is inside. */
static int best_inside(const Matrix *root, Vec rest, const Vec c[3], const Vec e[3], Vec normal, Vec *away)
{
    int longest = 0, near = 0;
    for (int j = 1; j < 3; j++) {
        if (dot(e[j], e[j]) > dot(e[longest], e[longest])) longest = j;
        if (dot(c[j], c[j]) < dot(c[near], c[near])) near = j;
    }
    double size = length(e[longest]), s, t;
    Vec inward = cross(normal, e[longest]);
    Vec along = vec(e[longest].x / size, e[longest].y / size, e[longest].z / size);
    Vec aside = vec(inward.x / size, inward.y / size, inward.z / size);
    /* The corner nearest to the anchor leaves the fewest digits behind. */
    Vec foot = times(dot(normal, c[near]), normal);
    two_columns(apply(root, along), apply(root, aside), plus(apply(root, foot), rest), &s, &t);
    *away = plus(plus(foot, times(s, along)), times(t, aside));
    for (int j = 0; j < 3; j++)
        if (!(dot(cross(normal, e[j]), minus(*away, c[j])) >= 0)) return 0;
    return 1;
}

/* The best point of side j; from the lesser of its ends, so that both triangles of an edge find the same bits. */
static Vec best_on_edge(const Matrix *root, Vec rest, const Vec c[3], Vec edge, int j, int *corner)
{
    int swap = edge.x < 0 || (edge.x == 0 && (edge.y < 0 || (edge.y == 0 && edge.z < 0)));
    Vec begin = swap ? c[AFTER[j]] : c[j];
    if (swap) edge = vec(-edge.x, -edge.y, -edge.z);
    double start = -dot(begin, edge) / dot(edge, edge);
    Vec foot = plus(begin, times(start, edge));
    Vec g = apply(root, edge), h = plus(apply(root, foot), rest);
    double steep = dot(g, g), step = steep > 0 ? -dot(g, h) / steep : 0.0;
    int low = start + step <= 0, high = start + step >= 1;
    *corner = !(low || high) ? -1 : (low != swap) ? j : AFTER[j];
    return *corner < 0 ? plus(foot, times(step, edge)) : c[*corner];
}

/* Minimises |root (anchor + d) - offset| over a triangle whose corners `c` are counted from the anchor. */
static Polished polish(const Matrix *root, Vec rest, const Vec c[3], Vec normal)
{
    Vec e[3] = {minus(c[1], c[0]), minus(c[2], c[1]), minus(c[0], c[2])}, twice = plus(rest, rest), image;
    Polished best = {.corner = -1, .rise = INFINITE};
    if (best_inside(root, rest, c, e, normal, &best.away)) {
        image = apply(root, best.away);
        best.rise = dot(image, plus(twice, image));
    }
    /* Inside comes first, and so wins where it is equal. */
    for (int j = 0; j < 3; j++) {
        int corner;
        Vec away = best_on_edge(root, rest, c, e[j], j, &corner);
        image = apply(root, away);
        double rise = dot(image, plus(twice, image));
        if (rise < best.rise) best = (Polished){away, corner, rise, 0};
    }
    image = apply(root, best.away);
    for (int i = 0; i < 3; i++) {
        Vec row = root->row[i];
        /* A product's rounding is at most 32 times that of its size. */
        double rounding = 32 * EPS * root_of(dot(row, row) * dot(best.away, best.away));
        best.unsure += rounding * (2.0 * (size_of(rest.at[i]) + size_of(image.at[i])) + rounding);
    }
    return best;
}

#endif
