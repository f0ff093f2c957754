/* The surface's point nearest to a target in a metric, exactly: the optimum over all triangles (paper, II-B).
 *
 * The metric is given by its root: minimise |root p - offset|^2, so nothing is squared. A walk down the tree
 * (`skincal/mesh/search.py`) leaves out whatever cannot be the best. With the rows r_i and the largest stretch s of the
 * root, and y = root c - offset at the centre c of a node, every point p of its ball of radius r has
 *
 *     |root p - offset| >= |y| - s r    and    >= sqrt(sum_i max(0, |y_i| - |r_i| r)^2),
 *
 * the first the tighter for a round metric, the second for one that hardly sees a direction. Where all triangles of the
 * node face the push, |y| bounds the optimum from above, since c is a point of the surface. A node whose lower bound
 * exceeds the upper one is left out, as is one whose triangles all turn away from the push. Bounds are taken in single
 * precision, with a slack for its rounding: what is left is a superset of the answer, never the answer itself.
 *
 * What is left is solved in closed form, and what is equally near is ordered by what it is. So an answer has the same
 * bits whichever others are asked with it, wherever the search starts, and as if every triangle were tried.
 */
#ifndef SEARCH_H
#define SEARCH_H

#include "triangle.h"

/* Points whose distances in the metric, scaled so that the root's largest number is near 1, differ by less are equally
 * near: rounding. */
static const double TIE = 1e-12;
/* A metric whose lightest row is below this share of its heaviest is stiff: its optimum is found once more, in small
 * numbers (`polish`), and so it is on a sliver. Elsewhere the rounding is at most 20 times that of a length, and a
 * length's is 1e-17 m. */
static const double STIFF = 0.05;
/* Share of a point's largest coordinate by which two triangles' roundings of one point differ at most. */
static const double SAME_POINT = 4 * 0x1p-52;
/* Metres. Equally near points whose depth along the push differs by less are one place. */
static const double SAME_DEPTH = 1e-9;
/* Rounding of a distance in single precision, as a share of what went into it, with room to spare. */
static const double SLACK = 2e-6;
/* Largest stretches are 0.5 or more but for a root of zero. */
static const double LEAST_STRETCH = 1e-2;
/* Sum of the squared stretches over the largest of them: a metric below this has a second stretch below half the first. */
static const double FLAT = 1.25;

/* Metres. Beyond, single precision tells nothing, and every triangle is tried. */
static const double FAR = 1e15;
/* Metres, farther than any distance where bounds are taken. */
static const float FARTHEST = 1e18f;

/* |root (p - origin) - offset|^2 with its push, of numbers near 1. */
typedef struct {
    Matrix root;
    Vec offset;  /* for points from the tree's origin */
    Vec whole;   /* for points from the link's origin */
    Vec push;    /* unit; zero where it has no length, and then it faces nothing */
    double scale; /* a power of two, by which root and offsets were multiplied */
    int any;     /* whether every triangle counts, whatever the push */
    int stiff;
    int flat;
    int all;     /* nothing is left out by bounds */
    int tried;   /* triangles solved */
    float rows[3][3], offsets[3], pushes[3], lengths[3], stretch, slack;
} Metric;

/* A triangle's best point that may be the optimum. */
typedef struct { double distance, facing; Closest at; int node; } __attribute__((aligned(16))) Candidate;

typedef struct { int count; Candidate *all; } Candidates;

/* The best point; triangle -1 where there is none. */
typedef struct { Vec point; int triangle; double value; } Best;

/* At least the largest stretch of a root, at most 1.07 times it: |M^4|^(1/8) with M = root' root. */
static double stretch_of(const Matrix *root)
{
    double m[3][3], n[3][3], sum = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            m[i][j] = 0;
            for (int k = 0; k < 3; k++) m[i][j] += root->row[k].at[i] * root->row[k].at[j];
        }
    for (int twice = 0; twice < 2; twice++) {
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) n[i][j] = m[i][0] * m[0][j] + m[i][1] * m[1][j] + m[i][2] * m[2][j];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) m[i][j] = n[i][j];
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) sum += square(m[i][j]);
    return larger(root_of(root_of(root_of(root_of(sum)))) * (1 + SINGLE_PRECISION_MARGIN_SHARE), LEAST_STRETCH);
}

static void set_bounds(Metric *m, double extent)
{
    double reach = size_of(m->offset.x) + size_of(m->offset.y) + size_of(m->offset.z), squares = 0;
    double stretch = stretch_of(&m->root);
    for (int i = 0; i < 3; i++) {
        double size = length(m->root.row[i]);
        reach += size * extent;
        squares += size * size;
        m->lengths[i] = (float)size;
        for (int j = 0; j < 3; j++) m->rows[i][j] = (float)m->root.row[i].at[j];
        m->offsets[i] = (float)m->offset.at[i];
        m->pushes[i] = (float)m->push.at[i];
    }
    m->stretch = (float)stretch;
    m->slack = (float)(3 * TIE + SLACK * reach);
    m->flat = squares < FLAT * stretch * stretch;
    m->all = !(reach < FAR);
}

/* `push` may be null: every triangle counts. */
static Metric metric_of(const Surface *s, const Matrix *root, Vec offset, const Vec *push)
{
    Metric m;
    int exponent;
    double most = 0, rows[3];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) most = larger(most, size_of(root->row[i].at[j]));
    fraction(most, &exponent);
    /* Powers of two change no digit, and no square leaves the range of numbers. */
    m.scale = power_of_two(-exponent);
    for (int i = 0; i < 3; i++) m.root.row[i] = times(m.scale, root->row[i]);
    m.whole = times(m.scale, offset);
    m.offset = minus(m.whole, apply(&m.root, vec_at(s->origin)));
    double size = push ? length(*push) : 0;
    m.push = size > 0 ? vec(push->x / size, push->y / size, push->z / size) : vec(0, 0, 0);
    m.any = !push;
    for (int i = 0; i < 3; i++) rows[i] = dot(m.root.row[i], m.root.row[i]);
    m.stiff = smaller(rows[0], smaller(rows[1], rows[2])) < STIFF * STIFF * larger(rows[0], larger(rows[1], rows[2]));
    m.tried = 0;
    set_bounds(&m, s->extent);
    return m;
}

/* ---- one triangle ---- */

INLINE double facing_of(const Surface *s, const Metric *m, int node)
{
    return dot(vec_at(s->normals + 3 * s->order[node]), m->push);
}

INLINE void corners_of(const Surface *s, int triangle, Vec corners[3])
{
    for (int j = 0; j < 3; j++) corners[j] = vec_at(s->vertices + 3 * s->triangles[3 * triangle + j]);
}

/* Solves a triangle in the metric; 0 where it does not face the push. */
static int solve_node(const Surface *s, Metric *m, int node, Candidate *found)
{
    Vec image[3];
    found->node = node;
    found->facing = facing_of(s, m, node);
    if (!m->any && !(found->facing < -PUSHED_FACE_MIN_COSINE)) return 0;
    m->tried++;
    for (int j = 0; j < 3; j++) image[j] = minus(apply(&m->root, vec_at(s->corners + 9 * node + 3 * j)), m->offset);
    found->at = closest_to_origin(image);
    found->distance = root_of(found->at.squared);
    return 1;
}

static Vec candidate_point(const Surface *s, const Candidate *c)
{
    Vec corners[3];
    corners_of(s, s->order[c->node], corners);
    return point_of(&c->at, corners);
}

/* ---- down the tree ---- */

/* A ball whose inside does not count, from the tree's origin; radius 0 where there is none. */
typedef struct { float middle[3], radius; } Hole;

typedef struct { int level, node; float lower; } Step;

/* The lower bounds of eight nodes, infinite for those left out; lowers `limit` by what surely bounds the optimum. */
static void bound_eight(const Metric *m, const float *row, const Hole *hole, float *limit, float lower[NODE_CHILDREN])
{
    float distance[NODE_CHILDREN], y[3][NODE_CHILDREN], toward[NODE_CHILDREN], best = *limit;
    for (int k = 0; k < NODE_CHILDREN; k++) {
        float x0 = row[k], x1 = row[NODE_CHILDREN + k], x2 = row[2 * NODE_CHILDREN + k];
        for (int i = 0; i < 3; i++) y[i][k] = m->rows[i][0] * x0 + m->rows[i][1] * x1 + m->rows[i][2] * x2 - m->offsets[i];
        distance[k] = __builtin_sqrtf(y[0][k] * y[0][k] + y[1][k] * y[1][k] + y[2][k] * y[2][k]);
        lower[k] = distance[k] - m->stretch * row[3 * NODE_CHILDREN + k];
        toward[k] = row[4 * NODE_CHILDREN + k] * m->pushes[0] + row[5 * NODE_CHILDREN + k] * m->pushes[1] + row[6 * NODE_CHILDREN + k] * m->pushes[2];
    }
    for (int k = 0; k < NODE_CHILDREN; k++) {
        float sine = row[7 * NODE_CHILDREN + k], radius = row[3 * NODE_CHILDREN + k];
        if (m->any || toward[k] < -sine) best = distance[k] < best ? distance[k] : best;
        if (!m->any && toward[k] > sine) lower[k] = __builtin_inff();
        if (radius < 0) lower[k] = __builtin_inff();
        if (m->flat && lower[k] < __builtin_inff()) {
            float aside = 0;
            for (int i = 0; i < 3; i++) {
                float far = __builtin_fabsf(y[i][k]) - m->lengths[i] * radius;
                if (far > 0) aside += far * far;
            }
            aside = __builtin_sqrtf(aside);
            if (aside > lower[k]) lower[k] = aside;
        }
        if (hole->radius > 0) {
            float off[3] = {row[k] - hole->middle[0], row[NODE_CHILDREN + k] - hole->middle[1], row[2 * NODE_CHILDREN + k] - hole->middle[2]};
            if (!(__builtin_sqrtf(off[0] * off[0] + off[1] * off[1] + off[2] * off[2]) + radius > hole->radius))
                lower[k] = __builtin_inff();
        }
    }
    *limit = best;
}

/* Up to which lower bound a node is kept. */
INLINE float within(const Metric *m, float limit) { return limit * (float)(1 + SINGLE_PRECISION_MARGIN_SHARE) + m->slack; }

static void keep(Candidates *found, const Candidate *candidate)
{
    /* `found` is the newest on the stack of memory, and grows there. */
    *ROOM(Candidate, 1) = *candidate;
    found->count++;
}

/* The steps of a walk: at most eight a level at once. */
typedef struct { int count; Step all[NODE_CHILDREN * (SEARCH_TREE_MAX_DEPTH + 1)]; } Ahead;

/* Puts a row's nodes on the walk, the nearest on top. */
static void put_ahead(Ahead *ahead, int level, int row, const float lower[NODE_CHILDREN], float bound)
{
    int first = ahead->count;
    for (int k = 0; k < NODE_CHILDREN; k++) {
        if (!(lower[k] <= bound && lower[k] < FARTHEST)) continue;
        int at = ahead->count++;
        for (; at > first && ahead->all[at - 1].lower < lower[k]; at--) ahead->all[at] = ahead->all[at - 1];
        ahead->all[at] = (Step){level, row * NODE_CHILDREN + k, lower[k]};
    }
}

/* Finds the triangles that may hold the optimum, or, where `fixed`, all of which a point comes within `limit` outside the
 * hole. What is returned lies on top of the memory. */
static Candidates candidates_of(const Surface *s, Metric *m, float limit, int fixed, const Hole *hole)
{
    Candidates found = {0, (Candidate *)top};
    Candidate candidate;
    if (m->all) {
        for (int node = 0; node < (int)s->triangle_count; node++)
            if (solve_node(s, m, node, &candidate)) keep(&found, &candidate);
        return found;
    }
    Ahead ahead = {0};
    float lower[NODE_CHILDREN], ignored;
    int highest = (int)s->level_count - 1;
    for (int row = 0; row < (int)(s->node_counts[highest] / NODE_CHILDREN); row++) {
        ignored = limit;
        bound_eight(m, s->levels[highest] + 64 * row, hole, fixed ? &ignored : &limit, lower);
        put_ahead(&ahead, highest, row, lower, within(m, limit));
    }
    while (ahead.count) {
        Step step = ahead.all[--ahead.count];
        if (!(step.lower <= within(m, limit))) continue;
        if (step.level > 0) {
            ignored = limit;
            bound_eight(m, s->levels[step.level - 1] + 64 * step.node, hole, fixed ? &ignored : &limit, lower);
            put_ahead(&ahead, step.level - 1, step.node, lower, within(m, limit));
        } else if (solve_node(s, m, step.node, &candidate)) {
            if (!fixed && candidate.distance < limit) limit = (float)(candidate.distance * (1 + SINGLE_PRECISION_MARGIN_SHARE));
            keep(&found, &candidate);
        }
    }
    return found;
}

/* ---- the best of what is left ---- */

/* Keeps those whose number in `measure` is at most the least of them plus `slack`; returns how many. */
static int keep_least(Candidate *all, Vec *points, double *values, double *measure, int count, double slack)
{
    double least = INFINITE;
    int kept = 0;
    for (int i = 0; i < count; i++) if (measure[i] < least) least = measure[i];
    for (int i = 0; i < count; i++) {
        if (!(measure[i] <= least + slack)) continue;
        all[kept] = all[i];
        points[kept] = points[i];
        values[kept] = values[i];
        kept++;
    }
    return kept;
}

/* Which of two comes first where nothing else tells them apart: by their place in the mesh, not in the tree. */
INLINE int lesser(const Surface *s, const Candidate *a, const Candidate *b)
{
    return s->order[a->node] < s->order[b->node];
}

/* Solves the triangles once more about the best of them; returns how many are as near as the best then. */
static int polish_all(const Surface *s, const Metric *m, Candidate *all, int count, Vec *points, double *values)
{
    int near = 0, best = 0, kept = 0;
    Polished *again = ROOM(Polished, count);
    for (int i = 1; i < count; i++)
        if (all[i].distance < all[near].distance || (all[i].distance == all[near].distance && lesser(s, &all[i], &all[near])))
            near = i;
    Vec anchor = candidate_point(s, &all[near]);
    /* From the link's origin again: the tree's may be far off. */
    Vec rest = minus(apply(&m->root, anchor), m->whole);
    for (int i = 0; i < count; i++) {
        Vec corners[3], from[3];
        corners_of(s, s->order[all[i].node], corners);
        for (int j = 0; j < 3; j++) from[j] = minus(corners[j], anchor);
        again[i] = polish(&m->root, rest, from, vec_at(s->normals + 3 * s->order[all[i].node]));
        points[i] = again[i].corner >= 0 ? corners[again[i].corner] : plus(anchor, again[i].away);
        if (again[i].rise < again[best].rise || (again[i].rise == again[best].rise && lesser(s, &all[i], &all[best]))) best = i;
    }
    Polished first = again[best];
    Vec there = points[best];
    for (int i = 0; i < count; i++) {
        Vec off = minus(points[i], there);
        double far = larger(size_of(off.x), larger(size_of(off.y), size_of(off.z)));
        double size = larger(size_of(points[i].x), larger(size_of(points[i].y), size_of(points[i].z)));
        if (!(again[i].rise <= first.rise + again[i].unsure || far <= SAME_POINT * size)) continue;
        Vec image = plus(rest, apply(&m->root, again[i].away));
        all[kept] = all[i];
        points[kept] = points[i];
        values[kept++] = dot(image, image);
    }
    return kept;
}

/* The best of the candidates; of equally near ones the first met by the push, then the one that faces it most, then the
 * lowest triangle. */
static Best best_of(const Surface *s, const Metric *m, Candidates found)
{
    Best best = {vec(__builtin_nan(""), __builtin_nan(""), __builtin_nan("")), -1, INFINITE};
    double least = INFINITE;
    int count = 0, again = m->stiff;
    for (int i = 0; i < found.count; i++) if (found.all[i].distance < least) least = found.all[i].distance;
    for (int i = 0; i < found.count; i++) if (found.all[i].distance <= least + TIE) found.all[count++] = found.all[i];
    if (count == 0) return best;
    Vec *points = ROOM(Vec, count);
    double *values = ROOM(double, count), *measure = ROOM(double, count);
    for (int i = 0; i < count; i++) again |= s->slim[s->order[found.all[i].node]];
    if (again) {
        count = polish_all(s, m, found.all, count, points, values);
    } else {
        for (int i = 0; i < count; i++) {
            points[i] = candidate_point(s, &found.all[i]);
            values[i] = found.all[i].at.squared;
        }
    }
    for (int i = 0; i < count; i++) measure[i] = dot(points[i], m->push);
    count = keep_least(found.all, points, values, measure, count, SAME_DEPTH);
    for (int i = 0; i < count; i++) measure[i] = found.all[i].facing;
    count = keep_least(found.all, points, values, measure, count, SAME_DEPTH);
    for (int i = 0; i < count; i++) measure[i] = s->order[found.all[i].node];
    keep_least(found.all, points, values, measure, count, 0);
    best = (Best){points[0], s->order[found.all[0].node], values[0] / m->scale / m->scale};
    return best;
}

/* The optimum over all triangles; `start` is a triangle where it is likely, or -1: quicker, with the same answer. */
static Best nearest_to(const Surface *s, Metric *m, int start)
{
    static const Hole NO_HOLE = {{0, 0, 0}, 0};
    unsigned char *mark = top;
    Candidate first;
    float limit = FARTHEST;
    if (start >= 0 && start < (int)s->triangle_count && solve_node(s, m, s->places[start], &first))
        if (first.distance < limit) limit = (float)(first.distance * (1 + SINGLE_PRECISION_MARGIN_SHARE));
    Best best = best_of(s, m, candidates_of(s, m, limit, 0, &NO_HOLE));
    top = mark;
    return best;
}

#endif
