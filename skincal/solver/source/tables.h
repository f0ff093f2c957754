/* Written by `python -m tools.solver` from `skincal/solver/tables.py`, where the numbers have their reasons. Do not edit. */
#ifndef TABLES_H
#define TABLES_H

#include "base.h"

#define LAYOUT_NUMBER 1070475621

static const double FULL_TRUST_SDS = 2.8;
static const double ZERO_TRUST_SDS = 3.8;
enum { MIN_POKES_FOR_TRUST = 4 };
static const double MIN_SUM_OF_POKE_TRUSTS = 2.0;
static const double FULL_WEIGHT_MAX_MISS_SDS = 2.0;
static const double SMALL_SAMPLE_SPREAD_CORRECTION = 6.0;
static const double CHI2_1DOF_MEDIAN = 0.4549;
static const double CHI2_2DOF_MEDIAN = 1.3863;
static const double NEIGHBOURS_SHARE_ONE_OFFSET_FROM = 0.4;
static const double PUSHED_FACE_MIN_COSINE = 1e-12;
static const double SINGLE_PRECISION_MARGIN_SHARE = 1e-06;
enum { NODE_CHILDREN = 8 };
enum { SEARCH_TREE_MAX_DEPTH = 16 };

#define OFFSET(table, field, bytes) _Static_assert(__builtin_offsetof(table, field) == bytes, #table "." #field)
#define SIZE(table, bytes) _Static_assert(sizeof(table) == bytes, #table)

/* Standard deviations of the rig: `NoiseSettings` of `skincal/model/scene.py`. */
typedef struct {
    double force; /* N */
    double moment; /* N m */
    double contact; /* metres */
    double reach; /* metres */
    double radius; /* metres */
    double pose_turn; /* rad */
    double pose_shift; /* metres */
} Noise;
OFFSET(Noise, force, 0); OFFSET(Noise, moment, 8); OFFSET(Noise, contact, 16); OFFSET(Noise, reach, 24); OFFSET(Noise, radius,
32); OFFSET(Noise, pose_turn, 40); OFFSET(Noise, pose_shift, 48); SIZE(Noise, 56);

/* When a second minimum is reported. */
typedef struct {
    double max_odds; /* below these */
    double min_distance; /* this far from the best one at least, metres */
} Rivals;
OFFSET(Rivals, max_odds, 0); OFFSET(Rivals, min_distance, 8); SIZE(Rivals, 16);

/* The tree and the mesh, as `skincal/mesh/search.py` writes them. */
typedef struct {
    Word triangle_count;
    Word level_count;
    const float *levels[16]; /* rows of eight nodes: x (8), y, z, radii, mean normals, sines */
    Word node_counts[16]; /* filled up to whole rows */
    const int *order; /* (nt) the triangle that is node i of level 0 */
    const int *places; /* (nt) the node that each triangle is */
    const double *corners; /* (nt, 9) of the node i: its corners, metres, from the tree's origin */
    const double *vertices; /* (nv, 3) metres */
    const int *triangles; /* (nt, 3) */
    const double *normals; /* (nt, 3) unit */
    const unsigned char *slim; /* (nt) slivers */
    const int *fan_starts; /* (nv + 1) of each vertex in `fans` */
    const int *fans; /* the triangles around each vertex */
    int *walked; /* (nt), as the next two and the stamp for `rival.h`: which walk saw the node last */
    double *lowest; /* (nv) */
    int *lowest_stamp; /* (nv) */
    int stamp;
    double origin[3]; /* metres */
    double extent; /* metres, largest distance of a vertex from the origin */
} Surface;
OFFSET(Surface, triangle_count, 0); OFFSET(Surface, level_count, 4); OFFSET(Surface, levels, 8); OFFSET(Surface, node_counts,
72); OFFSET(Surface, order, 136); OFFSET(Surface, places, 140); OFFSET(Surface, corners, 144); OFFSET(Surface, vertices, 148);
OFFSET(Surface, triangles, 152); OFFSET(Surface, normals, 156); OFFSET(Surface, slim, 160); OFFSET(Surface, fan_starts, 164);
OFFSET(Surface, fans, 168); OFFSET(Surface, walked, 172); OFFSET(Surface, lowest, 176); OFFSET(Surface, lowest_stamp, 180);
OFFSET(Surface, stamp, 184); OFFSET(Surface, origin, 192); OFFSET(Surface, extent, 216); SIZE(Surface, 224);

/* What is walked on. */
typedef struct {
    const Surface *surface;
    const int *over; /* (nt, 3) the triangle behind each side, below zero at the rim */
} Ground;
OFFSET(Ground, surface, 0); OFFSET(Ground, over, 4); SIZE(Ground, 8);

/* How well a position is known. */
typedef struct {
    double covariance[3][3]; /* metres^2 */
    double worst_direction[3]; /* unit */
    double sd; /* metres, along it; infinite if a direction is not determined */
    double rms; /* metres, root of the covariance's trace */
    double miss; /* metres, weighted rms distance of the axes */
} Known;
OFFSET(Known, covariance, 0); OFFSET(Known, worst_direction, 72); OFFSET(Known, sd, 96); OFFSET(Known, rms, 104); OFFSET(Known,
miss, 112); SIZE(Known, 120);

/* Solution of a taxel. All numbers are 64-bit floats. */
typedef struct {
    double root[3][3]; /* the rows' squares are |root p - offset|^2 and a constant (`factor.h`) */
    double offset[3];
    double solution[3]; /* metres, least-squares point; of smallest norm if the rank is below three */
    double blind[3]; /* unit direction that the rows do not determine if the rank is 2, else zeros */
    double rank; /* number of determined directions of `solution` */
    double push[3]; /* weighted mean of the push directions, shorter than 1 the more they differ */
    double outward[3]; /* against it, unit */
    double opposed; /* 1 if the pushes cancel, so that no side is outward */
    Known free; /* `solution` */
    double point[3]; /* metres, best point of the surface; NaN if no triangle faces the pushes */
    double value; /* |root p - offset|^2 there */
    double triangle; /* -1 without one */
    Known on_surface; /* `point` */
    double rival[3]; /* metres, second minimum */
    double rival_triangle;
    double odds; /* how many times less likely it is; infinite without one */
} Answer;
OFFSET(Answer, root, 0); OFFSET(Answer, offset, 72); OFFSET(Answer, solution, 96); OFFSET(Answer, blind, 120); OFFSET(Answer,
rank, 144); OFFSET(Answer, push, 152); OFFSET(Answer, outward, 176); OFFSET(Answer, opposed, 200); OFFSET(Answer, free, 208);
OFFSET(Answer, point, 328); OFFSET(Answer, value, 352); OFFSET(Answer, triangle, 360); OFFSET(Answer, on_surface, 368);
OFFSET(Answer, rival, 488); OFFSET(Answer, rival_triangle, 512); OFFSET(Answer, odds, 520); SIZE(Answer, 528);

/* Question of `solve`: t taxels with n answers. */
typedef struct {
    Word taxels;
    Word answers;
    const int *starts; /* (t + 1): taxel i has the answers starts[i] to starts[i + 1], at least one */
    const double *columns; /* (17, n) as `Evidence.columns` */
    const double *weights; /* (n) */
    const int *poses; /* (n) */
    const Noise *noise;
    const Rivals *rivals;
    double *trust; /* (n) found, or given if `trusting` */
    Word trusting; /* whether trust is given */
    Word free; /* whether to solve by the free method */
    Surface *surface; /* null: no surface method */
    const int *starting; /* (t) triangles where the optima are likely, -1 for none */
    Answer *said; /* (t) */
} Task;
OFFSET(Task, taxels, 0); OFFSET(Task, answers, 4); OFFSET(Task, starts, 8); OFFSET(Task, columns, 12); OFFSET(Task, weights,
16); OFFSET(Task, poses, 20); OFFSET(Task, noise, 24); OFFSET(Task, rivals, 28); OFFSET(Task, trust, 32); OFFSET(Task, trusting,
36); OFFSET(Task, free, 40); OFFSET(Task, surface, 44); OFFSET(Task, starting, 48); OFFSET(Task, said, 52); SIZE(Task, 56);

/* Question of `carry`: n contacts, to be carried into the link frame. */
typedef struct {
    Word contacts;
    const double *forces; /* (n, 3), sensor frame, N */
    const double *moments; /* (n, 3), sensor frame, N m */
    const double *poses; /* (n, 4, 4), link_from_sensor */
    double *columns; /* (17, n) as `Evidence.columns` */
} Carry;
OFFSET(Carry, contacts, 0); OFFSET(Carry, forces, 4); OFFSET(Carry, moments, 8); OFFSET(Carry, poses, 12); OFFSET(Carry,
columns, 16); SIZE(Carry, 20);

/* Question of `factor`: least squares of t systems with m rows in all. */
typedef struct {
    Word systems;
    Word rows;
    const int *starts; /* (t + 1) */
    const double *columns; /* (4, m): A by columns, b */
    double *roots; /* (t, 9) */
    double *offsets; /* (t, 3) */
    double *solutions; /* (t, 3) */
    double *blind; /* (t, 3) */
    int *ranks; /* (t) */
} Systems;
OFFSET(Systems, systems, 0); OFFSET(Systems, rows, 4); OFFSET(Systems, starts, 8); OFFSET(Systems, columns, 12); OFFSET(Systems,
roots, 16); OFFSET(Systems, offsets, 20); OFFSET(Systems, solutions, 24); OFFSET(Systems, blind, 28); OFFSET(Systems, ranks,
32); SIZE(Systems, 36);

/* Question of `nearest` and `second`: best points of a surface, or second minima, for t metrics. */
typedef struct {
    Surface *surface;
    Word metrics;
    Word all; /* whether every triangle is tried */
    const double *roots; /* (t, 9) */
    const double *offsets; /* (t, 3) */
    const double *pushes; /* (t, 3); null: every triangle counts */
    const int *starting; /* (t) */
    const double *best; /* (t, 3), for second minima as the next two */
    const double *radii; /* (t) */
    const double *limits; /* (t) */
    double *points; /* (t, 3) */
    double *values; /* (t) */
    int *triangles; /* (t); second minima: given if there is a best one, else -1 */
    int *tried; /* (t) how many triangles were solved */
} Search;
OFFSET(Search, surface, 0); OFFSET(Search, metrics, 4); OFFSET(Search, all, 8); OFFSET(Search, roots, 12); OFFSET(Search,
offsets, 16); OFFSET(Search, pushes, 20); OFFSET(Search, starting, 24); OFFSET(Search, best, 28); OFFSET(Search, radii, 32);
OFFSET(Search, limits, 36); OFFSET(Search, points, 40); OFFSET(Search, values, 44); OFFSET(Search, triangles, 48);
OFFSET(Search, tried, 52); SIZE(Search, 56);

/* Question of `walk`: n walks over a surface. */
typedef struct {
    const Ground *ground;
    Word walks;
    const double *ways; /* (n, 2) metres, along x and along normal x x */
    double *points; /* (n, 3) metres, where they begin, then where they end */
    double *x; /* (n, 3) unit, as `points` */
    int *triangles; /* (n) as `points` */
} Walks;
OFFSET(Walks, ground, 0); OFFSET(Walks, walks, 4); OFFSET(Walks, ways, 8); OFFSET(Walks, points, 12); OFFSET(Walks, x, 16);
OFFSET(Walks, triangles, 20); SIZE(Walks, 24);

/* Thresholds of the search for a module's pose: `skincal/modules/pose_fit.py` has their values and reasons. */
typedef struct {
    double turn_to_length_radius; /* metres */
    double min_pokes_per_arm_pose;
    double robust_search_steps;
    double max_step; /* metres */
    double rounding_max_step; /* metres */
    double converged_step; /* metres */
    double min_curvature; /* over that of the rows alone */
    double min_reversal_share; /* of a step that is halved */
    double max_steps;
    double min_singular_value_ratio;
    double turn_max_sd; /* rad, of a start */
    double residual_scale; /* metres, of a start */
    double reweighting_steps; /* of a start */
    double min_direction; /* length of a direction in a plane below which it is across it */
} Rules;
OFFSET(Rules, turn_to_length_radius, 0); OFFSET(Rules, min_pokes_per_arm_pose, 8); OFFSET(Rules, robust_search_steps, 16);
OFFSET(Rules, max_step, 24); OFFSET(Rules, rounding_max_step, 32); OFFSET(Rules, converged_step, 40); OFFSET(Rules,
min_curvature, 48); OFFSET(Rules, min_reversal_share, 56); OFFSET(Rules, max_steps, 64); OFFSET(Rules, min_singular_value_ratio,
72); OFFSET(Rules, turn_max_sd, 80); OFFSET(Rules, residual_scale, 88); OFFSET(Rules, reweighting_steps, 96); OFFSET(Rules,
min_direction, 104); SIZE(Rules, 112);

/* Question of `start_modules`: b modules, and e estimates of their taxels with a position. */
typedef struct {
    Word modules;
    const Rules *rules;
    const Ground *ground; /* null: modules lie anywhere */
    const int *spans; /* (b + 1): module i has the estimates spans[i] to spans[i + 1] */
    const double *flat; /* (e, 2) metres, of their pads */
    const double *places; /* (e, 3) metres */
    const double *outward; /* (e, 3) unit */
    const double *weights; /* (e) 1/metres^2 */
    const int *planned; /* (b) whether the next two are known */
    const double *planned_x; /* (b, 3) unit */
    const double *planned_normals; /* (b, 3) unit */
    double *points; /* (b, 3) metres, of the poses */
    double *x; /* (b, 3) unit */
    double *normals; /* (b, 3) unit */
    int *triangles; /* (b) */
    int *known; /* (b) whether there is a pose */
} Starts;
OFFSET(Starts, modules, 0); OFFSET(Starts, rules, 4); OFFSET(Starts, ground, 8); OFFSET(Starts, spans, 12); OFFSET(Starts, flat,
16); OFFSET(Starts, places, 20); OFFSET(Starts, outward, 24); OFFSET(Starts, weights, 28); OFFSET(Starts, planned, 32);
OFFSET(Starts, planned_x, 36); OFFSET(Starts, planned_normals, 40); OFFSET(Starts, points, 44); OFFSET(Starts, x, 48);
OFFSET(Starts, normals, 52); OFFSET(Starts, triangles, 56); OFFSET(Starts, known, 60); SIZE(Starts, 64);

/* m pokes with a answers on modules with n pads and d unknowns each. */
typedef struct {
    Word pokes;
    Word unknowns;
    const int *starts; /* (m + 1): poke i has the answers starts[i] to starts[i + 1] */
    const int *answers; /* (a) pads */
    const double *shares; /* (a) of the middle */
    const double *columns; /* (17, m) as `Evidence.columns` */
    const int *poses; /* (m) equal if the arm's pose is */
    const double *offsets; /* (m) metres^2 */
    const Noise *noise;
    const Rules *rules;
    double *pads; /* (n, 3) metres */
    double *changes; /* (n, 3, d), of the pads by the unknowns */
    double *outward; /* (n, 3) unit */
} Touches;
OFFSET(Touches, pokes, 0); OFFSET(Touches, unknowns, 4); OFFSET(Touches, starts, 8); OFFSET(Touches, answers, 12);
OFFSET(Touches, shares, 16); OFFSET(Touches, columns, 20); OFFSET(Touches, poses, 24); OFFSET(Touches, offsets, 28);
OFFSET(Touches, noise, 32); OFFSET(Touches, rules, 36); OFFSET(Touches, pads, 40); OFFSET(Touches, changes, 44); OFFSET(Touches,
outward, 48); SIZE(Touches, 52);

/* The whitened rows of m pokes on modules. */
typedef struct {
    double *row_slopes; /* (m, 2, d) */
    double *row_misses; /* (m, 2) */
    double *row_whiten; /* (m, 2, 2) */
    double *row_normals; /* (m, 3) of the skin at the middles */
    double *row_bends; /* (m, d, d), see `add_bends` */
} RowTable;
OFFSET(RowTable, row_slopes, 0); OFFSET(RowTable, row_misses, 4); OFFSET(RowTable, row_whiten, 8); OFFSET(RowTable, row_normals,
12); OFFSET(RowTable, row_bends, 16); SIZE(RowTable, 20);

/* Question of `place_modules`: b modules to be placed. */
typedef struct {
    Touches touches;
    Word modules;
    Word doubting; /* whether outliers count less */
    const int *spans; /* (b + 1): module i has the pokes spans[i] to spans[i + 1] */
    const int *boards; /* (b + 1): and these pads */
    const double *flat; /* (n, 2) metres */
    const Ground *ground; /* null: modules lie anywhere */
    double *trust; /* (m) given, or found if `doubting` */
    double *points; /* (b, 3) metres, of the poses: the start, then the answer */
    double *x; /* (b, 3) unit, as `points` */
    double *normals; /* (b, 3) unit, as `points` */
    int *triangles; /* (b) as `points` */
    int *under; /* (n) triangles of the pads */
    double *covariances; /* (b, d, d) */
    double *blind; /* (b, d, d): the directions that are not determined as rows, the others zero */
    double *misses; /* (b) metres */
    double *moving; /* (b) metres */
    RowTable rows; /* at the answer */
} Boards;
OFFSET(Boards, touches, 0); OFFSET(Boards, modules, 52); OFFSET(Boards, doubting, 56); OFFSET(Boards, spans, 60); OFFSET(Boards,
boards, 64); OFFSET(Boards, flat, 68); OFFSET(Boards, ground, 72); OFFSET(Boards, trust, 76); OFFSET(Boards, points, 80);
OFFSET(Boards, x, 84); OFFSET(Boards, normals, 88); OFFSET(Boards, triangles, 92); OFFSET(Boards, under, 96); OFFSET(Boards,
covariances, 100); OFFSET(Boards, blind, 104); OFFSET(Boards, misses, 108); OFFSET(Boards, moving, 112); OFFSET(Boards, rows,
116); SIZE(Boards, 136);

/* Question of `module_rows`: the whitened rows of pokes on modules whose pads lie as given. */
typedef struct {
    Touches touches;
    double *row_slopes; /* as in `RowTable`, as the next four */
    double *row_misses;
    double *row_whiten;
    double *row_normals;
    double *row_bends;
} ModuleRows;
OFFSET(ModuleRows, touches, 0); OFFSET(ModuleRows, row_slopes, 52); OFFSET(ModuleRows, row_misses, 56); OFFSET(ModuleRows,
row_whiten, 60); OFFSET(ModuleRows, row_normals, 64); OFFSET(ModuleRows, row_bends, 68); SIZE(ModuleRows, 72);

/* How errors that pokes share spread: `skincal/taxels/shared_errors.py` has the values and reasons. */
typedef struct {
    double pokes_per_drift_block;
    double max_drift_pair_gap; /* difference of the numbers of two pokes */
    double drift_factor_if_corrected; /* of the variance */
    double unranked_shift; /* over the distance of the pokes */
    double min_information_ratio;
    double skin; /* metres, sd of its thickness */
} SpreadRules;
OFFSET(SpreadRules, pokes_per_drift_block, 0); OFFSET(SpreadRules, max_drift_pair_gap, 8); OFFSET(SpreadRules,
drift_factor_if_corrected, 16); OFFSET(SpreadRules, unranked_shift, 24); OFFSET(SpreadRules, min_information_ratio, 32);
OFFSET(SpreadRules, skin, 40); SIZE(SpreadRules, 48);

/* When a module is off its mesh: `skincal/modules/off_surface.py` has the values and reasons. */
typedef struct {
    double min_information_share;
    double subtracted_skin_sds;
    double max_sd; /* metres */
    double significant_sds;
} HeightRules;
OFFSET(HeightRules, min_information_share, 0); OFFSET(HeightRules, subtracted_skin_sds, 8); OFFSET(HeightRules, max_sd, 16);
OFFSET(HeightRules, significant_sds, 24); SIZE(HeightRules, 32);

/* Question of `spread_taxels`: t taxels with positions and n answers, and k and l errors that pokes share. */
typedef struct {
    Word taxels;
    Word answers;
    const int *starts; /* (t + 1) as in `Task` */
    const double *columns; /* (17, n) as `Evidence.columns` */
    const double *weights; /* (n) */
    const int *poses; /* (n) */
    const int *pokes; /* (n) their numbers */
    const unsigned char *unranked; /* (n) */
    const double *trust; /* (n) */
    const Noise *noise;
    const SpreadRules *rules;
    Word on_surface; /* whether the taxels lie in the plane of their triangle */
    Word corrected; /* whether a correction moved the arm poses */
    const double *positions; /* (t, 3) metres */
    const double *normals; /* (t, 3) unit, or zero */
    Word errors; /* k, of all pokes */
    Word pose_errors; /* l, of the pokes in one arm pose */
    const double *alike; /* (n, 2, k) metres; a taxel's answers by the numbers of their pokes, as the next */
    const double *of_pose; /* (n, 2, l) metres */
    double *covariances; /* (t, 3, 3) metres^2, without and then with the shared errors */
    double *worst; /* (t, 3) unit */
    double *sds; /* (t) metres, along it */
    double *rms; /* (t) metres */
    double *moved; /* (t, 3, k) metres */
} TaxelSpread;
OFFSET(TaxelSpread, taxels, 0); OFFSET(TaxelSpread, answers, 4); OFFSET(TaxelSpread, starts, 8); OFFSET(TaxelSpread, columns,
12); OFFSET(TaxelSpread, weights, 16); OFFSET(TaxelSpread, poses, 20); OFFSET(TaxelSpread, pokes, 24); OFFSET(TaxelSpread,
unranked, 28); OFFSET(TaxelSpread, trust, 32); OFFSET(TaxelSpread, noise, 36); OFFSET(TaxelSpread, rules, 40);
OFFSET(TaxelSpread, on_surface, 44); OFFSET(TaxelSpread, corrected, 48); OFFSET(TaxelSpread, positions, 52); OFFSET(TaxelSpread,
normals, 56); OFFSET(TaxelSpread, errors, 60); OFFSET(TaxelSpread, pose_errors, 64); OFFSET(TaxelSpread, alike, 68);
OFFSET(TaxelSpread, of_pose, 72); OFFSET(TaxelSpread, covariances, 76); OFFSET(TaxelSpread, worst, 80); OFFSET(TaxelSpread, sds,
84); OFFSET(TaxelSpread, rms, 88); OFFSET(TaxelSpread, moved, 92); SIZE(TaxelSpread, 96);

/* Question of `spread_modules`: b modules with d unknowns and m pokes by number, and k and l errors that pokes share. */
typedef struct {
    Word modules;
    Word rows; /* m */
    Word unknowns;
    const int *starts; /* (b + 1): module i has the pokes starts[i] to starts[i + 1] */
    const double *columns; /* (17, m) as `Evidence.columns` */
    const int *poses; /* (m) */
    const int *pokes; /* (m) their numbers */
    const double *slopes; /* (m, 2, d) as in `RowTable`, as the next three */
    const double *misses; /* (m, 2) */
    const double *whiten; /* (m, 2, 2) */
    const double *normals; /* (m, 3) */
    const double *trust; /* (m) */
    const SpreadRules *rules;
    const HeightRules *heights_by; /* null: without a surface */
    Word corrected; /* whether a correction moved the arm poses */
    Word errors; /* k, of all pokes */
    Word pose_errors; /* l, of the pokes in one arm pose */
    const double *alike; /* (m, 2, k) metres */
    const double *of_pose; /* (m, 2, l) metres */
    Word given; /* whether the next two are given */
    double *inverses; /* (b, d, d) of the information */
    double *factors; /* (b) of the variance by the scene's noise */
    double *added; /* (b, d, d) covariance of the unknowns by slow errors, the skin and errors of poses */
    double *moves; /* (b, d, k) shifts of the unknowns */
    double *heights; /* (b) metres^2 */
} ModuleSpread;
OFFSET(ModuleSpread, modules, 0); OFFSET(ModuleSpread, rows, 4); OFFSET(ModuleSpread, unknowns, 8); OFFSET(ModuleSpread, starts,
12); OFFSET(ModuleSpread, columns, 16); OFFSET(ModuleSpread, poses, 20); OFFSET(ModuleSpread, pokes, 24); OFFSET(ModuleSpread,
slopes, 28); OFFSET(ModuleSpread, misses, 32); OFFSET(ModuleSpread, whiten, 36); OFFSET(ModuleSpread, normals, 40);
OFFSET(ModuleSpread, trust, 44); OFFSET(ModuleSpread, rules, 48); OFFSET(ModuleSpread, heights_by, 52); OFFSET(ModuleSpread,
corrected, 56); OFFSET(ModuleSpread, errors, 60); OFFSET(ModuleSpread, pose_errors, 64); OFFSET(ModuleSpread, alike, 68);
OFFSET(ModuleSpread, of_pose, 72); OFFSET(ModuleSpread, given, 76); OFFSET(ModuleSpread, inverses, 80); OFFSET(ModuleSpread,
factors, 84); OFFSET(ModuleSpread, added, 88); OFFSET(ModuleSpread, moves, 92); OFFSET(ModuleSpread, heights, 96);
SIZE(ModuleSpread, 100);

/* Question of `trusts`: n pokes. */
typedef struct {
    Word pokes;
    const double *squares; /* (n) squared misses, in standard deviations */
    double *trust; /* (n) */
} Trusts;
OFFSET(Trusts, pokes, 0); OFFSET(Trusts, squares, 4); OFFSET(Trusts, trust, 8); SIZE(Trusts, 12);

/* The question of each function. */
typedef union {
    Task solve;
    Carry carry;
    Systems factor;
    Search nearest;
    Search second;
    Walks walk;
    Starts start_modules;
    Boards place_modules;
    ModuleRows module_rows;
    TaxelSpread spread_taxels;
    ModuleSpread spread_modules;
    Trusts trusts;
} Questions;

#endif
