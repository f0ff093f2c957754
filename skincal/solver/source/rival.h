/* The least separate minimum beside the best one.
 *
 * A walk downhill goes from triangle to triangle that share a corner, among those that face the push, as long as one has a
 * nearer point. A minimum is the end of such walks, with all triangles around it that are equally near; it is separate where
 * none of them comes within a radius of the best point.
 */
#ifndef RIVAL_H
#define RIVAL_H

#include "cover.h"

/* Rounds in which triangles equally near are gone over; what is not at its end by then is a valley, not a place. */
static const int PLATEAU = 64;

/* Where another minimum counts. */
typedef struct { Vec middle; double radius; } Beside;

static int outside(const Beside *b, Vec p) { return length(minus(p, b->middle)) > b->radius; }

/* Drops the candidates that have a lower one at their corners among those given: they are no minima. */
static void keep_lowest(Surface *s, Candidates *found)
{
    int kept = 0, stamp = ++s->stamp;
    for (int i = 0; i < found->count; i++)
        for (int j = 0; j < 3; j++) {
            int vertex = s->triangles[3 * s->order[found->all[i].node] + j];
            double other = s->lowest_stamp[vertex] == stamp ? s->lowest[vertex] : INFINITE;
            s->lowest_stamp[vertex] = stamp;
            s->lowest[vertex] = smaller(other, found->all[i].distance);
        }
    for (int i = 0; i < found->count; i++) {
        const int *vertices = s->triangles + 3 * s->order[found->all[i].node];
        double least = smaller(s->lowest[vertices[0]], smaller(s->lowest[vertices[1]], s->lowest[vertices[2]]));
        if (found->all[i].distance <= least + TIE) found->all[kept++] = found->all[i];
    }
    found->count = kept;
}

/* Whether a triangle is the end of walks away from the best point: none around all that are equally near is nearer. */
static int is_end(Surface *s, Metric *m, const Beside *beside, const Candidate *from)
{
    unsigned char *mark = top;
    int stamp = ++s->stamp, count = 1, end = 1;
    int *edge = ROOM(int, s->triangle_count), *next = ROOM(int, s->triangle_count);
    edge[0] = from->node;
    s->walked[from->node] = stamp;
    for (int round = 0; count && end; round++) {
        int met = 0;
        if (round == PLATEAU) end = 0;
        for (int i = 0; i < count && end; i++) {
            const int *vertices = s->triangles + 3 * s->order[edge[i]];
            for (int j = 0; j < 3 && end; j++)
                for (int k = s->fan_starts[vertices[j]]; k < s->fan_starts[vertices[j] + 1] && end; k++) {
                    Candidate candidate;
                    int node = s->places[s->fans[k]];
                    if (s->walked[node] == stamp) continue;
                    s->walked[node] = stamp;
                    if (!solve_node(s, m, node, &candidate)) continue;
                    double off = candidate.distance - from->distance;
                    if (off < -TIE) end = 0;
                    if (off > TIE) continue;
                    if (!outside(beside, candidate_point(s, &candidate))) end = 0;
                    next[met++] = node;
                }
        }
        int *other = edge;
        edge = next;
        next = other;
        count = met;
    }
    top = mark;
    return end;
}

static int is_reached(const Surface *s, Metric *m, const Candidate *c, Cover deepest)
{
    return cover_of(s, m, candidate_point(s, c), s->order[c->node], 0) <= deepest;
}

/* The second minimum, where its value is at most `limit`, it lies outside `radius` of the best one and no deeper under other
 * walls than `deepest`. */
static Best second_to(Surface *s, Metric *m, Vec best, double radius, double limit, Cover deepest)
{
    unsigned char *mark = top;
    double squared = limit * m->scale * m->scale, far = smaller(root_of(squared), FARTHEST / 2);
    Vec middle = minus(best, vec_at(s->origin));
    double hollow = radius * (1 - SINGLE_PRECISION_MARGIN_SHARE) - SLACK * s->extent;
    Hole hole = {{(float)middle.x, (float)middle.y, (float)middle.z}, (float)hollow};
    Beside beside = {best, radius};
    Candidates found = candidates_of(s, m, (float)(far * (1 + SINGLE_PRECISION_MARGIN_SHARE)), 1, &hole);
    int kept = 0;
    for (int i = 0; i < found.count; i++)
        if (found.all[i].at.squared <= squared && outside(&beside, candidate_point(s, &found.all[i])))
            found.all[kept++] = found.all[i];
    found.count = kept;
    keep_lowest(s, &found);
    kept = 0;
    for (int i = 0; i < found.count; i++)
        if (is_end(s, m, &beside, &found.all[i]) && (deepest == CLOSED || is_reached(s, m, &found.all[i], deepest)))
            found.all[kept++] = found.all[i];
    found.count = kept;
    Best second = best_of(s, m, found);
    top = mark;
    return second;
}

#endif
