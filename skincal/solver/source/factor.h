/* Least squares with rows of very different size and columns that are nearly dependent: Householder QR.
 *
 * Rows are sorted by size, largest first, and the largest remaining column comes next. With both, each row's backward
 * error is rounding times that row's own size, so rows weighted 1e-12 keep their digits beside rows weighted 1 (Powell and
 * Reid 1968; Cox and Higham 1998; Bjoerck 1996, section 4.4). Normal equations lose half of all digits where columns are
 * nearly dependent. See `docs/decisions/least-squares.md`.
 *
 * Columns are not moved: the pivot's place is remembered, and the factor's rows stand in the order of p.
 */
#ifndef FACTOR_H
#define FACTOR_H

#include "contacts.h"

/* A triangular factor's diagonal below this share of the size of the rows it was made of is rounding: it determines
 * nothing. The rows that are left at each step, not all of them: beside a heavy row, light ones may determine the rest. */
static const double NO_RANK = 1e-14;
/* Rows that are longer than the one before them by less than this count as sorted: rounding of a length. */
static const double SORTED = 1.0 + 1e-9;

/* |A p - b|^2 = |root p - offset|^2 + a constant. */
typedef struct {
    Matrix root;
    Vec offset;
    int order[3];  /* columns in the order of elimination: root with its columns so ordered is upper triangular */
    int rank;      /* how many directions of p the rows determine */
    Vec solution;  /* of the smallest norm where that is fewer than three */
    Vec blind;     /* unit, the direction that the rows say nothing of, where the rank is 2; else zero */
} Factor;

/* m rows A | b, column by column. */
typedef struct { int count; double *column[4]; } Rows;

static Rows room_for_rows(int count)
{
    Rows rows = {.count = count};
    for (int j = 0; j < 4; j++) rows.column[j] = ROOM(double, count);
    return rows;
}

/* The weighted rows of eq. (5), two a contact. */
static Rows rows_of(const Contacts *c)
{
    Rows rows = room_for_rows(2 * c->count);
    for (int i = 0; i < c->count; i++) {
        Vec nearest = column(c->nearest, i), e[2] = {column(c->first, i), column(c->second, i)};
        for (int j = 0; j < 2; j++) {
            Vec row = times(c->scale[i], e[j]);
            int at = 2 * i + j;
            rows.column[0][at] = row.x;
            rows.column[1][at] = row.y;
            rows.column[2][at] = row.z;
            rows.column[3][at] = dot(row, nearest);
        }
    }
    return rows;
}

INLINE double row_square(const Rows *rows, int i)
{
    return square(rows->column[0][i]) + square(rows->column[1][i]) + square(rows->column[2][i]);
}

/* Largest first; stable, so that equal rows keep their order. Evidence comes sorted but for doubted contacts. */
static void sort_rows(Rows *rows)
{
    unsigned char *mark = top;
    double *keys = ROOM(double, rows->count);
    int rises = 0;
    for (int i = 0; i < rows->count; i++) {
        keys[i] = -row_square(rows, i);
        rises |= i > 0 && -keys[i] > -keys[i - 1] * SORTED;
    }
    if (rises) {
        int *order = ROOM(int, rows->count);
        double *sorted = ROOM(double, rows->count);
        sort_by(keys, rows->count, order);
        for (int j = 0; j < 4; j++) {
            for (int i = 0; i < rows->count; i++) sorted[i] = rows->column[j][order[i]];
            for (int i = 0; i < rows->count; i++) rows->column[j][i] = sorted[i];
        }
    }
    top = mark;
}

static double product_of(const double *p, const double *q, int first, int count)
{
    Sum total = {0, 0};
    for (int at = first; at < count; at += BLOCK) {
        double sum = 0;
        int end = at + BLOCK < count ? at + BLOCK : count;
        for (int i = at; i < end; i++) sum += p[i] * q[i];
        add(&total, sum);
    }
    return total_of(total);
}

/* Reflects the rows from k on so that the pivot column is zero below; writes the factor's row k. */
static void eliminate(Rows *rows, int k, int left[3], Factor *f)
{
    int count = rows->count, pivot = 0;
    double most = -1.0;
    for (int j = 0; j < 3; j++) {
        double squared = left[j] ? product_of(rows->column[j], rows->column[j], k, count) : -1.0;
        if (squared > most) { most = squared; pivot = j; }
    }
    double size = root_of(most), row[4] = {0, 0, 0, 0};
    f->order[k] = pivot;
    left[pivot] = 0;
    if (k < count && size > 0) {
        double *v = rows->column[pivot], lead = v[k];
        /* The sign that adds: no digits cancel. v'v = 2 size (size + |lead|). */
        double alpha = signed_as(size, lead), beta = 1.0 / (size * (size + size_of(lead)));
        v[k] = lead + alpha;
        for (int j = 0; j < 4; j++) {
            double *w = rows->column[j];
            if (j == pivot || (j < 3 && !left[j])) continue;
            double along = beta * product_of(v, w, k, count);
            for (int i = k; i < count; i++) w[i] -= v[i] * along;
            row[j] = w[k];
        }
        row[pivot] = -alpha;
    }
    f->root.row[k] = vec_at(row);
    f->offset.at[k] = row[3];
}

/* The factor's last row, where one column is left. A plain projection: a reflection would add a heavy row's first number
 * to a column that is light, and lose its digits. */
static void project(const Rows *rows, const int left[3], Factor *f)
{
    int pivot = left[0] ? 0 : left[1] ? 1 : 2;
    const double *v = rows->column[pivot];
    double size = root_of(product_of(v, v, 2, rows->count)), along = product_of(v, rows->column[3], 2, rows->count);
    f->order[2] = pivot;
    f->root.row[2] = vec(0, 0, 0);
    f->root.row[2].at[pivot] = size;
    f->offset.z = size > 0 ? along / size : 0.0;
}

/* Below which a diagonal of the factor is rounding of the rows that are left at its step. */
static void find_noises(const Rows *rows, double noises[3])
{
    for (int k = 0; k < 3; k++) {
        Sum squares = {0, 0};
        /* Not subtracted from the sum: what is left may be 1e-24 of it. */
        for (int i = k; i < rows->count; i++) add(&squares, row_square(rows, i));
        noises[k] = NO_RANK * root_of(total_of(squares));
    }
}

/* The x of smallest norm with row x = offset for one or two rows, in the factor's order of columns. */
static Vec smallest(const Vec rows[2], int rank, const double offsets[2], Vec *blind)
{
    *blind = vec(0, 0, 0);
    if (rank == 0) return *blind;
    if (rank == 1) return times(offsets[0] / dot(rows[0], rows[0]), rows[0]);
    /* The second row starts with a zero, so it is the better one to take across: rows = L Q', x = Q L^-1 offset. */
    double size = length(rows[0]);
    Vec q1 = times(1.0 / size, rows[0]);
    double shared = dot(rows[1], q1);
    Vec rest = minus(rows[1], times(shared, q1));
    rest = minus(rest, times(dot(rest, q1), q1));
    double size2 = length(rest);
    Vec q2 = times(1.0 / size2, rest), normal = cross(rows[0], rows[1]);
    double x1 = offsets[0] / size, x2 = (offsets[1] - shared * x1) / size2;
    *blind = times(1.0 / length(normal), normal);
    return plus(times(x1, q1), times(x2, q2));
}

INLINE double root_at(const Factor *f, int k, int j) { return f->root.row[k].at[f->order[j]]; }

/* Rank, solution and blind direction from the triangular factor. */
static void solve_factor(Factor *f, const double noises[3])
{
    double offsets[3], x[3];
    Vec r[3], blind = vec(0, 0, 0);
    f->rank = 0;
    for (int k = 0; k < 3; k++) {
        if (!(size_of(root_at(f, k, k)) > noises[k])) continue;
        r[f->rank] = vec(root_at(f, k, 0), root_at(f, k, 1), root_at(f, k, 2));
        offsets[f->rank++] = f->offset.at[k];
    }
    if (f->rank == 3) {
        x[2] = offsets[2] / r[2].z;
        x[1] = (offsets[1] - r[1].z * x[2]) / r[1].y;
        x[0] = (offsets[0] - r[0].y * x[1] - r[0].z * x[2]) / r[0].x;
    } else {
        put(x, smallest(r, f->rank, offsets, &blind));
    }
    for (int j = 0; j < 3; j++) {
        f->solution.at[f->order[j]] = x[j];
        f->blind.at[f->order[j]] = blind.at[j];
    }
}

/* Minimises |A p - b|; the rows are used up. */
static Factor factor_rows(Rows *rows)
{
    Factor f;
    double noises[3];
    int left[3] = {1, 1, 1};
    sort_rows(rows);
    find_noises(rows, noises);
    eliminate(rows, 0, left, &f);
    eliminate(rows, 1, left, &f);
    project(rows, left, &f);
    solve_factor(&f, noises);
    return f;
}

static Factor factor_of(const Contacts *c)
{
    unsigned char *mark = top;
    Rows rows = rows_of(c);
    Factor f = factor_rows(&rows);
    top = mark;
    return f;
}

#endif
