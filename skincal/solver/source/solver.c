/* The solver of skincal: everything between the contacts of many taxels and their positions with their uncertainty.
 *
 * Compiled for WebAssembly by `python -m tools.solver`. What a function is asked is written into `asked` before it is called:
 * where the memory that it may use begins, then a table of numbers and places of arrays.
 */
#include "modules.h"
#include "rival.h"
#include "spread.h"
#include "start.h"
#include "uncertainty.h"

#define EXPORT __attribute__((visibility("default")))

extern unsigned char __heap_base;

/* Length of the mean of unit pushes below which they cancel and no side is outward: a mean of 0.05 is chance for 400
 * pokes. */
static const double OPPOSED = 0.05;

static void put_known(Known *to, const Contacts *c, const Freedom *free, Vec p, const Noise *noise)
{
    Uncertainty u = propagate(c, free, p, noise);
    for (int k = 0; k < 9; k++) to->covariance[k / 3][k % 3] = u.covariance[k];
    put(to->worst_direction, u.weakest);
    to->sd = u.sd;
    to->rms = root_of(u.covariance[0] + u.covariance[4] + u.covariance[8]);
    to->miss = miss_of(c, p);
}

static Contacts contacts_of(const Task *t, int i)
{
    int begin = t->starts[i];
    const double *c = t->columns + begin;
    Word n = t->answers;
    Contacts found = {
        .count = t->starts[i + 1] - begin, .force = c + 6 * n, .pitch = c + 7 * n,
        .weight = t->weights + begin, .pose = t->poses + begin, .trust = t->trust + begin,
    };
    for (int k = 0; k < 3; k++) {
        found.u[k] = c + k * n;
        found.nearest[k] = c + (3 + k) * n;
        found.sensor[k] = c + (8 + k) * n;
        found.first[k] = c + (11 + k) * n;
        found.second[k] = c + (14 + k) * n;
    }
    found.scale = ROOM(double, found.count);
    found.weakness = ROOM(double, found.count);
    found.square = ROOM(double, found.count);
    set_offsets(&found, t->noise);
    return found;
}

/* How many times less likely a taxel lies at `other` than at `point`, where it fits by `worse` less well.
 *
 * With d from the estimate to the rival and A d what the rows differ by, the two sums of squares differ by s, which is
 * normal with mean +|A d|^2 where the estimate is right, -|A d|^2 where the rival is, and variance
 * tau^2 = 4 d'A' (K D K) A d (`uncertainty.h`) in both cases. So the odds for the estimate are exp(2 s |A d|^2 / tau^2). */
static double odds_of(const Contacts *c, Vec point, Vec other, double worse, const Noise *noise)
{
    double apart = 0, variance = 0;
    Vec d = minus(other, point);
    for (int i = 0; i < c->count; i++) {
        double scale = c->scale[i];
        double first = scale * dot(column(c->first, i), d), second = scale * dot(column(c->second, i), d);
        RowNoise n = row_noise(c, i, point, noise);
        apart += first * first + second * second;
        variance += n.even * (square(scale * first) + square(scale * second))
                  - square(scale * (n.less[0] * first + n.less[1] * second));
    }
    /* Where no row tells the two apart, neither does what is left of rounding. */
    if (worse <= 0 || !(variance > 0)) return 1.0;
    return power_of_e(smaller(2.0 * worse * apart / (4.0 * variance), 700.0));
}

/* The least sum of squares above the best one that no odds below the limit reach: tau^2 <= 4 |A d|^2 max(k^2 even), since
 * D <= even I. */
static double slack_of(const Contacts *c, Vec point, const Noise *noise, double odds)
{
    double most = 0;
    for (int i = 0; i < c->count; i++)
        most = larger(most, square(c->scale[i]) * row_noise(c, i, point, noise).even);
    return 2.0 * ln(odds) * most;
}

static double stretch_of_inverse(const Freedom *free)
{
    double sum = 0;
    for (int j = 0; j < free->d; j++)
        for (int k = 0; k < free->d; k++) sum += square(free->inverse[j][k]);
    return root_of(sum);
}

static void put_rival(Answer *said, Best rival, double odds)
{
    said->odds = odds;
    said->rival_triangle = rival.triangle;
    put(said->rival, rival.point);
}

/* Reports the second minimum that the noise could have made the worse one. Under other walls none does, if the best is under
 * none: COVERED_ODDS are as many as the largest odds reported. */
static void say_rival(
    const Task *t, Answer *said, const Contacts *c, const Factor *f, Metric *m, Best best, Cover under, const Freedom *space,
    const Freedom *plane)
{
    double slack = slack_of(c, best.point, t->noise, t->rivals->max_odds);
    /* Within this radius the sum of squares has not risen by the slack yet in the plane's flattest direction. */
    double radius = larger(t->rivals->min_distance, root_of(slack) * (plane->determined ? stretch_of_inverse(plane) : INFINITE));
    /* All that fits as well lies within this of the point where the axes meet, wherever the surface is. */
    double around = root_of(best.value + slack) * stretch_of_inverse(space) + length(minus(best.point, f->solution));
    if (around < radius || !finite(radius)) return;
    Best second = second_to(t->surface, m, best.point, radius, best.value + slack, under);
    if (second.triangle < 0) return;
    double odds = odds_of(c, best.point, second.point, second.value - best.value, t->noise);
    if (odds < t->rivals->max_odds) put_rival(said, second, odds);
}

/* The place that a push reaches from outside (`cover.h`) in place of `best`, and how it lies under other walls. Where one
 * under walls and one under none fit both, the other one is put down as the rival; returns whether it was compared. */
static int choose_wall(const Task *t, Answer *said, const Contacts *c, Metric *m, Best *best, Cover *under)
{
    double walls;
    *under = cover_of(t->surface, m, best->point, best->triangle, &walls);
    if (*under == CLOSED) {
        /* The wall that the push meets holds a minimum that is no worse than the place where it is met. */
        Best open = second_to(t->surface, m, best->point, 0, square(walls / m->scale) * (1 + SINGLE_PRECISION_MARGIN_SHARE), COVERED);
        if (open.triangle < 0) return 0;
        *best = open;
        *under = cover_of(t->surface, m, best->point, best->triangle, 0);
    }
    if (*under != COVERED) return 0;
    double slack = slack_of(c, best->point, t->noise, COVERED_ODDS * t->rivals->max_odds);
    Best outer = second_to(t->surface, m, best->point, 0, best->value + slack, OPEN), rival = outer;
    if (outer.triangle < 0) return 0;
    double odds = odds_of(c, best->point, outer.point, outer.value - best->value, t->noise) / COVERED_ODDS;
    if (odds < 1.0) {
        rival = *best;
        *best = outer;
        *under = OPEN;
        odds = 1.0 / odds;
    }
    if (odds < t->rivals->max_odds) put_rival(said, rival, odds);
    return 1;
}

static void say_on_surface(const Task *t, int i, const Contacts *c, const Factor *f, Vec push, const Freedom *space)
{
    Answer *said = t->said + i;
    Metric m = metric_of(t->surface, &f->root, f->offset, &push);
    Best best = nearest_to(t->surface, &m, t->starting[i]);
    Cover under = OPEN;
    int compared = best.triangle >= 0 && choose_wall(t, said, c, &m, &best, &under);
    put(said->point, best.point);
    said->triangle = best.triangle;
    said->value = best.value;
    said->on_surface.miss = said->on_surface.sd = INFINITE;
    if (best.triangle < 0) return;
    Freedom plane = in_plane(f, vec_at(t->surface->normals + 3 * best.triangle));
    put_known(&said->on_surface, c, &plane, best.point, t->noise);
    if (!compared) say_rival(t, said, c, f, &m, best, under, space, &plane);
}

static void solve_taxel(const Task *t, int i)
{
    Answer *said = t->said + i;
    *said = (Answer){.odds = INFINITE, .triangle = -1, .rival_triangle = -1};
    Contacts c = contacts_of(t, i);
    if (!t->trusting) find_trust(&c, t->noise);
    set_scales(&c);
    Factor f = factor_of(&c);
    Freedom space = in_space(&f);
    Vec push = mean_push(&c);
    for (int k = 0; k < 3; k++) put(said->root[k], f.root.row[k]);
    put(said->offset, f.offset);
    put(said->solution, f.solution);
    put(said->blind, f.blind);
    put(said->push, push);
    put(said->outward, times(-1.0 / length(push), push));
    said->rank = f.rank;
    said->opposed = length(push) < OPPOSED;
    if (t->free) put_known(&said->free, &c, &space, f.solution, t->noise);
    /* A taxel whose pushes cancel is blind; any push will do for it meanwhile. */
    if (t->surface) say_on_surface(t, i, &c, &f, said->opposed != 0 ? column(c.u, 0) : push, &space);
}

/* Without arguments a call costs a fifth: the host checks and converts each of them. */
static struct { unsigned char *begin; Questions on; } asked;
_Static_assert(__builtin_offsetof(__typeof__(asked), on) == 4, "`skincal/solver/machine.py` writes the question there");

static void begin(void)
{
    top = asked.begin;
    reach();
}

/* So that Python can see that it means the same tables. */
EXPORT int layout(void) { return LAYOUT_NUMBER; }

EXPORT void *asked_at(void) { return &asked; }
EXPORT void *heap(void) { return &__heap_base; }

EXPORT void solve(void)
{
    const Task *t = &asked.on.solve;
    begin();
    for (Word i = 0; i < t->taxels; i++) {
        unsigned char *mark = top;
        solve_taxel(t, (int)i);
        top = mark;
    }
}

/* Eq. (6): with p_w = Q p_s + t it is f_w = Q f_s and m_w = Q m_s + t x f_w. */
EXPORT void carry(void)
{
    const Carry *q = &asked.on.carry;
    begin();
    for (Word i = 0; i < q->contacts; i++) {
        const double *pose = q->poses + 16 * i;
        Matrix turned = {{vec_at(pose), vec_at(pose + 4), vec_at(pose + 8)}};
        Vec sensor = vec(pose[3], pose[7], pose[11]), force = apply(&turned, vec_at(q->forces + 3 * i));
        Vec moment = plus(apply(&turned, vec_at(q->moments + 3 * i)), cross(sensor, force)), first, second;
        double size = length(force);
        Vec u = vec(force.x / size, force.y / size, force.z / size), m = vec(moment.x / size, moment.y / size, moment.z / size);
        Vec nearest = cross(u, m);
        across(u, &first, &second);
        const double column[17] = {
            u.x, u.y, u.z, nearest.x, nearest.y, nearest.z, size, dot(u, m), sensor.x, sensor.y, sensor.z,
            first.x, first.y, first.z, second.x, second.y, second.z,
        };
        for (int k = 0; k < 17; k++) q->columns[k * q->contacts + i] = column[k];
    }
}

EXPORT void factor(void)
{
    const Systems *s = &asked.on.factor;
    for (Word i = 0; i < s->systems; i++) {
        begin();
        int first = s->starts[i];
        Rows rows = room_for_rows(s->starts[i + 1] - first);
        for (int j = 0; j < 4; j++)
            for (int k = 0; k < rows.count; k++) rows.column[j][k] = s->columns[j * s->rows + first + k];
        Factor f = factor_rows(&rows);
        for (int k = 0; k < 3; k++) put(s->roots + 9 * i + 3 * k, f.root.row[k]);
        put(s->offsets + 3 * i, f.offset);
        put(s->solutions + 3 * i, f.solution);
        put(s->blind + 3 * i, f.blind);
        s->ranks[i] = f.rank;
    }
}

static Metric metric_at(const Search *q, Word i)
{
    Matrix root = matrix_at(q->roots + 9 * i);
    Vec push = q->pushes ? vec_at(q->pushes + 3 * i) : vec(0, 0, 0);
    Metric m = metric_of(q->surface, &root, vec_at(q->offsets + 3 * i), q->pushes ? &push : 0);
    m.all |= (int)q->all;
    return m;
}

static void put_best(const Search *q, Word i, Best best)
{
    put(q->points + 3 * i, best.point);
    q->triangles[i] = best.triangle;
    q->values[i] = best.value;
}

EXPORT void nearest(void)
{
    const Search *q = &asked.on.nearest;
    begin();
    for (Word i = 0; i < q->metrics; i++) {
        Metric m = metric_at(q, i);
        put_best(q, i, nearest_to(q->surface, &m, q->starting[i]));
        q->tried[i] = m.tried;
    }
}

EXPORT void second(void)
{
    const Search *q = &asked.on.second;
    Best none = {vec(__builtin_nan(""), __builtin_nan(""), __builtin_nan("")), -1, INFINITE};
    begin();
    for (Word i = 0; i < q->metrics; i++) {
        Metric m = metric_at(q, i);
        Best found = q->triangles[i] < 0 ? none : second_to(q->surface, &m, vec_at(q->best + 3 * i), q->radii[i], q->limits[i], CLOSED);
        put_best(q, i, found);
        q->tried[i] = m.tried;
    }
}

EXPORT void walk(void)
{
    const Walks *q = &asked.on.walk;
    begin();
    for (Word i = 0; i < q->walks; i++) {
        Footing start = {q->triangles[i], vec_at(q->points + 3 * i), vec_at(q->x + 3 * i)};
        Footing end = walked(q->ground, start, q->ways[2 * i], q->ways[2 * i + 1]);
        put(q->points + 3 * i, end.point);
        put(q->x + 3 * i, end.x);
        q->triangles[i] = end.triangle;
    }
}

EXPORT void start_modules(void)
{
    const Starts *q = &asked.on.start_modules;
    begin();
    for (Word i = 0; i < q->modules; i++) {
        unsigned char *mark = top;
        q->known[i] = start_module(q, (int)i);
        top = mark;
    }
}

EXPORT void place_modules(void)
{
    const Boards *q = &asked.on.place_modules;
    begin();
    for (Word i = 0; i < q->modules; i++) {
        unsigned char *mark = top;
        place(q, (int)i);
        top = mark;
    }
}

EXPORT void module_rows(void)
{
    const ModuleRows *q = &asked.on.module_rows;
    const RowTable to = {q->row_slopes, q->row_misses, q->row_whiten, q->row_normals, q->row_bends};
    begin();
    for (Word i = 0; i < q->touches.pokes; i++) {
        Row r;
        row_of(&q->touches, (int)i, &r);
        put_row(&to, &q->touches, (int)i, &r);
    }
}

EXPORT void spread_taxels(void)
{
    const TaxelSpread *q = &asked.on.spread_taxels;
    begin();
    for (Word i = 0; i < q->taxels; i++) {
        unsigned char *mark = top;
        spread_taxel(q, (int)i);
        top = mark;
    }
}

EXPORT void spread_modules(void)
{
    const ModuleSpread *q = &asked.on.spread_modules;
    begin();
    for (Word i = 0; i < q->modules; i++) {
        unsigned char *mark = top;
        spread_module(q, (int)i);
        top = mark;
    }
}

EXPORT void trusts(void)
{
    const Trusts *q = &asked.on.trusts;
    begin();
    for (Word i = 0; i < q->pokes; i++) q->trust[i] = trust_at(q->squares[i]);
}
