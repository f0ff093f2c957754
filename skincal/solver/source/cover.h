/* Walls over a place on the surface.
 *
 * A push enters the part from outside. So of two walls that face it the outer one is touched: the inner one lies under it, as
 * the frame under a cover does, or the far wall of a tube under the near one. A place is covered where a wall is met from
 * there both against the push and along the place's own normal. The floor beside a step is met by a slanting push through the
 * step, but nothing is above it, and it is not covered.
 */
#ifndef COVER_H
#define COVER_H

#include "search.h"

/* Metres. Faces nearer than this are one wall: sheets that a mesh has twice. */
static const double SAME_WALL = 0.0005;
/* Metres. A tip does not get between walls that are nearer than this: it is 4 mm wide, and pokes lean. */
static const double NO_WAY_IN = 0.010;
/* How many times less likely than the noise says a push meets a covered place: few hands reach into a part. */
static const double COVERED_ODDS = 20.0;

/* Share of a triangle's size by which a line may miss it. */
static const double ON_EDGE = 1e-12;

/* The walls that a line meets from inside: the distance to the first one, infinite without any, and, where they are solved,
 * the largest distance of the walls in the metric. */
typedef struct { double first, farthest; } Met;

/* From p, counted from the tree's origin, along a unit vector to a triangle, if it is met from inside; else infinite. */
static double way_to(const Surface *s, Vec p, Vec along, int node)
{
    if (!(dot(vec_at(s->normals + 3 * s->order[node]), along) > PUSHED_FACE_MIN_COSINE)) return INFINITE;
    Vec c[3];
    for (int j = 0; j < 3; j++) c[j] = minus(vec_at(s->corners + 9 * node + 3 * j), p);
    double shares[3], sum = 0, way = 0;
    for (int j = 0; j < 3; j++) {
        Vec next = c[AFTER[j]], other = c[BEFORE[j]];
        shares[j] = dot(along, cross(next, other));
        /* A line through an edge or a corner meets every triangle there, however the rounding falls. */
        if (!(shares[j] >= -ON_EDGE * length(next) * length(other))) return INFINITE;
        sum += shares[j];
    }
    if (!(sum > 0)) return INFINITE;
    for (int j = 0; j < 3; j++) way += shares[j] / sum * dot(c[j], along);
    return way > SAME_WALL ? way : INFINITE;
}

/* The walls from p, metres, link frame, along a unit vector; `m` may be null. */
static Met walls_from(const Surface *s, Metric *m, Vec p, Vec along)
{
    Met met = {INFINITE, 0};
    Ahead ahead = {0};
    Candidate candidate;
    double slack = SLACK * s->extent;
    int highest = (int)s->level_count - 1, level = highest, row = 0, rows = (int)(s->node_counts[highest] / NODE_CHILDREN);
    p = minus(p, vec_at(s->origin));
    while (row < rows || ahead.count) {
        int at = row;
        if (row < rows) row++;
        else {
            Step step = ahead.all[--ahead.count];
            if (step.level == 0) {
                double way = way_to(s, p, along, step.node);
                met.first = smaller(met.first, way);
                if (m && finite(way) && solve_node(s, m, step.node, &candidate))
                    met.farthest = larger(met.farthest, candidate.distance);
                continue;
            }
            level = step.level - 1;
            at = step.node;
        }
        const float *eight = s->levels[level] + 64 * at;
        for (int k = 0; k < NODE_CHILDREN; k++) {
            double radius = eight[3 * NODE_CHILDREN + k] + slack;
            Vec off = minus(vec(eight[k], eight[NODE_CHILDREN + k], eight[2 * NODE_CHILDREN + k]), p);
            double way = dot(off, along);
            if (radius < 0 || way + radius < SAME_WALL || dot(off, off) - way * way > radius * radius) continue;
            ahead.all[ahead.count++] = (Step){level, at * NODE_CHILDREN + k, 0};
        }
    }
    return met;
}

typedef enum { OPEN, COVERED, CLOSED } Cover;

/* How a place lies under other walls; `limit` gets the largest distance in the metric of the walls that the push meets first. */
static Cover cover_of(const Surface *s, Metric *m, Vec p, int triangle, double *limit)
{
    Met before = walls_from(s, limit ? m : 0, p, times(-1.0, m->push));
    if (limit) *limit = before.farthest;
    if (!finite(before.first)) return OPEN;
    Met above = walls_from(s, 0, p, vec_at(s->normals + 3 * triangle));
    return !finite(above.first) ? OPEN : above.first < NO_WAY_IN ? CLOSED : COVERED;
}

#endif
