/* Motions of lanes in fixed steps, as `_drive_plainly` of motion.py computes them without a compiler.
 * Macros that end in _AT and _END are rows of the states, and with NEW_ of the results of the graph
 * "checked", which begin with those of "motion".
 */
#define ROWS T_END
#define RESULTS MOTION_RESULTS
#define PLACED PLACING_RESULTS
#define STATES X_END
#define MOVING Q_END
#define POSITIONS (P_END - P_AT)
#define FIRST_POSITION P_AT
#define NEW_POSITIONS NEW_P_AT
#define UNKNOWNS (NEW_W_END - NEW_W_AT)
#define FIRST_UNKNOWN W_AT
#define NEW_UNKNOWNS NEW_W_AT
#define CHANGE NEW_CHANGE_AT
#define ERROR NEW_ERROR_AT
#define SPEED NEW_SPEED_AT
#define TIME T_AT
#define FORCES (NEW_F_END - NEW_F_AT)
#define FIRST_FORCE F_AT
#define NEW_FORCES NEW_F_AT
#define DOUBT NEW_DOUBT_AT
#define FIRST_DISTANCE NEW_DISTANCES_AT
#define END_DISTANCES NEW_DISTANCES_END
#define INPUTS (U_END - U_AT)
#define FIRST_INPUT U_AT
#define FIRST_BEFORE V_AT
#define BEFORE (NEW_BEFORE_END - NEW_BEFORE_AT)
#define LAST_RELAXING X_END
#define FIRST_RELAXING (X_END - REST)

static void moved(vd *s, const vd *start, const vd *k, vd h) {
  for (int i = 0; i < MOVING; i++) s[i] = start[i] + h * k[i];
}

static vl corrected(vd *s, const vd *r, double most, double worst) {
  for (int i = 0; i < POSITIONS; i++) s[FIRST_POSITION + i] = r[NEW_POSITIONS + i];
  for (int i = 0; i < UNKNOWNS; i++) s[FIRST_UNKNOWN + i] = r[NEW_UNKNOWNS + i];
  return (r[CHANGE] < splat(most)) & (r[ERROR] <= splat(worst));
}

static inline int any(vl mask) {
  long long bits = 0;
  for (int l = 0; l < LANES; l++) bits |= mask[l];
  return bits != 0;
}

#if LAG_END > LAG_AT
/* The damping of two linearly implicit half steps is complete for infinitely stiff contacts. */
static vl stepped(vd *s, const vd *a, const vd *k1, vd h, vd *mean, vd *r, double most, double worst,
                  const double *K, const Cells *cells) {
  vd start[MOVING], half = SPLAT(0.5) * h, middle[MOVING];
  (void)k1; (void)mean; /* of another lag */
  memcpy(s, a, ROWS * sizeof *s);
  s[LAG_AT] = half;
  eval_motion(s, r, K, cells);
  vl good = corrected(s, r, most, worst);
  memcpy(start, s, sizeof start);
  moved(s, start, r, half);
  s[TIME] = a[TIME] + half;
  memcpy(middle, s, sizeof middle);
  eval_motion(s, r, K, cells);
  good &= corrected(s, r, most, worst);
  moved(s, start, r, h);
  for (int i = FIRST_RELAXING; i < LAST_RELAXING; i++) s[i] = middle[i] + half * r[i];
  s[LAG_AT] = SPLAT(0.0);
  s[TIME] = a[TIME] + h;
  return good;
}
#else
static vl stepped(vd *s, const vd *a, const vd *k1, vd h, vd *mean, vd *r, double most, double worst,
                  const double *K, const Cells *cells) {
  vd k2[MOVING];
  memcpy(s, a, ROWS * sizeof *s);
  moved(s, a, k1, SPLAT(0.5) * h);
  s[TIME] = a[TIME] + SPLAT(0.5) * h;
  eval_motion(s, r, K, cells);
  vl good = corrected(s, r, most, worst);
  memcpy(k2, r, sizeof k2);
  moved(s, a, k2, SPLAT(0.75) * h);
  s[TIME] = a[TIME] + SPLAT(0.75) * h;
  eval_motion(s, r, K, cells);
  good &= corrected(s, r, most, worst);
  for (int i = 0; i < MOVING; i++)
    mean[i] = (SPLAT(2.0) * k1[i] + SPLAT(3.0) * k2[i] + SPLAT(4.0) * r[i]) / SPLAT(9.0);
  moved(s, a, mean, h);
  s[TIME] = a[TIME] + h;
  return good;
}
#endif

/* Correct a state by the graph "checked": k is the derivative; return which lanes are solved.
 *
 * Forces near a limit may need further Newton steps; other lanes keep their values. If `repeats` is
 * negative, there are no limits, and the graph "motion" suffices.
 */
static vl checked_at(vd *a, vd *k, vd *r, double most, double worst, double repeats, const double *K, const Cells *cells) {
  vd more[CHECKED_RESULTS];
  if (repeats < 0) eval_motion(a, r, K, cells);
  else eval_checked(a, r, K, cells);
  vl good = corrected(a, r, most, worst);
  memcpy(k, r, MOVING * sizeof *k);
  if (repeats >= 0)
    for (int i = 0; i < FORCES; i++) a[FIRST_FORCE + i] = r[NEW_FORCES + i];
  for (double j = 0; j < repeats; j++) {
    vl rough = good & ~(r[DOUBT] <= SPLAT(0.0));
    if (!any(rough)) break;
    eval_checked(a, more, K, cells);
    for (int i = NEW_FORCES; i < END_DISTANCES; i++) r[i] = pick(rough, more[i], r[i]);
    for (int i = 0; i < FORCES; i++) a[FIRST_FORCE + i] = r[NEW_FORCES + i];
  }
  return good;
}

/* Times and reasons of the ends of lanes, and states there. A reason is the index of a bound, or one
 * of the negative codes of motion.py. */
enum { COMPLETE = -1, UNSOLVED = -2, TOO_FAST = -5 };
typedef struct { vd time, reason, beyond[ROWS]; } Ends;

/* End those of the lanes that are beyond a limit; return the others. */
static vl inside(vl lanes, const vd *s, const vd *r, double rounding, Ends *ends) {
  vd least = SPLAT(INFINITY), bound = SPLAT(0.0);
  for (int i = FIRST_DISTANCE; i < END_DISTANCES; i++) {
    vl less = (r[i] < least) | (r[i] != r[i]);
    least = pick(less, r[i], least);
    bound = pick(less, splat(i - FIRST_DISTANCE), bound);
  }
  vl beyond = lanes & ~(least >= splat(-rounding));
  ends->time = pick(beyond, s[TIME], ends->time);
  ends->reason = pick(beyond, bound, ends->reason);
  for (int i = 0; i < ROWS; i++) ends->beyond[i] = pick(beyond, s[i], ends->beyond[i]);
  return lanes & ~beyond;
}

/* The point of a motion that lanes have reached: state, rates there, sums of the errors and speed. */
typedef struct { vd state[ROWS], rates[MOVING], errors[STATES], speed; } Point;

static void assign(vl lanes, Point *to, const Point *from) {
  vd *a = to->state;
  const vd *b = from->state;
  for (size_t i = 0; i < sizeof *to / sizeof *a; i++) a[i] = pick(lanes, b[i], a[i]);
}
static void assign_lane(Point *to, long l, const Point *from, long k) {
  vd *a = to->state;
  const vd *b = from->state;
  for (size_t i = 0; i < sizeof *to / sizeof *a; i++) a[i][l] = b[i][k];
}

#if BEFORE
/* Add the errors of a step of lanes: the integral of the defect beside the cubic path by the 3/8 rule, as
 * `_step_errors` of motion.py. `k2` are the rates at the end.
 */
static void add_errors(const Point *at, const vd *mean, const vd *k2, vd h, vd *sums, const double *K,
                       const Cells *cells) {
  vd z[ROWS], r[RESULTS], e[STATES];
  const vd *a = at->state, *k1 = at->rates;
  for (int i = 0; i < STATES; i++) e[i] = SPLAT(0.125) * (k1[i] + k2[i]) - mean[i];
  for (int j = 1; j < 3; j++) {
    double c = j / 3.0, d = 1 - c;
    memcpy(z, a, sizeof z);
    for (int i = 0; i < MOVING; i++)
      z[i] = a[i] + h * (splat(c * d * d) * k1[i] + splat(c * c * (3 - 2 * c)) * mean[i] - splat(c * c * d) * k2[i]);
    for (int i = 0; i < STATES; i++) z[i] = z[i] + SPLAT(4.0 / 3.0) * at->errors[i];
    z[TIME] = a[TIME] + splat(c) * h;
    eval_slopes(z, r, K, cells);
    for (int i = 0; i < STATES; i++) e[i] = e[i] + SPLAT(0.375) * r[i];
  }
  for (int i = 0; i < STATES; i++) sums[i] = at->errors[i] + h * e[i];
}
#endif

/* Known bounds of the ground around cells, for the wheel whose centre and axle are in `row` of the graph "placing":
 * the number of blocks of cells, then the numbers of `CellBounds`. */
typedef struct { double row, blocks, side, reach, corner[2], spacing[2], low[2], high[2]; } Wheel;

/* Places of a block, and its bounds of slope and of curvature, (2, side, side). */
typedef struct { long long place[2]; const double *bounds; } Block;

/* Whether the bounds exclude a second contact of lane l; contact/certify.py derives the condition. */
static int has_single_contact(const Wheel *wheel, const Block *block, const vd *placed, long l) {
  const vd *center = placed + (long)wheel->row, *axle = center + 3;
  double at[2], place[2];
  for (int i = 0; i < 2; i++) {
    if (!(center[i][l] >= wheel->low[i] && center[i][l] <= wheel->high[i])) return 0;
    at[i] = floor((center[i][l] - wheel->corner[i]) / wheel->spacing[i]);
    place[i] = floor(at[i] / wheel->side);
  }
  for (long k = 0; k < wheel->blocks; k++, block++) {
    if (block->place[0] != place[0] || block->place[1] != place[1]) continue;
    long side = (long)wheel->side, i = (long)(at[0] - place[0] * side), j = (long)(at[1] - place[1] * side);
    const double *slope = block->bounds + i * side + j, *curvature = slope + side * side;
    double level = sqrt(axle[0][l] * axle[0][l] + axle[1][l] * axle[1][l]), upright = axle[2][l];
    return wheel->reach * *curvature < level - *slope * (upright < 0 ? -upright : upright);
  }
  return 0;
}

/* Motions of n lanes over m samples: arguments and results of `drive` of evaluator.py. */
typedef struct {
  long n, m, kept, certified;  /* `kept` rows of the states are samples; number of wheels that are certified */
  const double *in, *inputs, *t; /* (ROWS, n), (INPUTS, m - 1, n), (m, n) */
  /* (n, m, width): kept rows, then estimated errors if wanted; (m - 1, n): numbers of steps, given if `tries` is
   * zero; (n, OUT): time and reason of the end, state there, state and length of the last step; (n, m): zero at samples
   * where every wheel has a single contact */
  double *samples, *counts, *out, *doubt;
  const Wheel *wheels;
  const Block *const *tables; /* blocks for each wheel */
  double length, longest, tries, finer, estimated, rounding, repeats, fastest;
  /* `counts` steps are followed by `graded` steps, each of half the length of the one before, to `last` */
  double graded, last, most, worst;
  double moved, places; /* Newton step of the positions of a sample that needs another one, and most of them */
} Run;
enum { OUT = 2 * ROWS + 3 };

static long width_of(const Run *run) { return run->estimated ? run->kept + STATES : run->kept; }

/* Correct the positions of samples of lanes to rounding; return which lanes have single contacts by known bounds. */
static vl placed_at(const Run *run, vl lanes, vd *s, const double *K, const Cells *cells) {
  vd r[POSITIONS + 1], wheels[PLACED + 1];
  vl moving = lanes, single = lanes;
  for (int j = 0; j < run->places && any(moving); j++) {
    eval_place(s, r, K, cells);
    for (int i = 0; i < POSITIONS; i++) s[FIRST_POSITION + i] = pick(moving, r[i], s[FIRST_POSITION + i]);
    moving &= r[POSITIONS] > splat(run->moved);
  }
  eval_placing(s, wheels, K, cells);
  for (long l = 0; l < LANES; l++)
    for (long w = 0; w < run->certified && single[l]; w++)
      single[l] = -has_single_contact(run->wheels + w, run->tables[w], wheels, l);
  return single;
}

/* Store the sample k of a lane, which is lane l of a vector. */
static void record(const Run *run, long lane, long k, const Point *at, const vd *state, long l) {
  double *row = run->samples + (lane * run->m + k) * width_of(run);
  for (long i = 0; i < run->kept; i++) row[i] = state[i][l];
  if (!run->estimated) return;
  row += run->kept;
  for (int i = 0; i < STATES; i++) row[i] = at->errors[i][l];
}

/* Store the end of a lane after its sample k - 1. */
static void finish(const Run *run, long lane, long k, double time, double reason, const vd *beyond, const vd *last,
                   double h, long l) {
  double *row = run->out + lane * OUT, *none = run->samples + lane * run->m * width_of(run);
  for (long i = k * width_of(run); i < run->m * width_of(run); i++) none[i] = NAN;
  row[0] = time;
  row[1] = reason;
  for (int i = 0; i < ROWS; i++) row[2 + i] = beyond[i][l];
  for (int i = 0; i < ROWS; i++) row[2 + ROWS + i] = last[i][l];
  row[OUT - 1] = h;
}

/* The interval of a lane of a vector, which ends at sample k, and its steps. */
typedef struct { long lane, k; double span, shortest, count, step, attempt, h; } Interval;

static double halvings(double number) { return (double)(1LL << (int)number); }

/* Begin the interval after a sample; return whether there is one. The lane ends otherwise. */
static int next_interval(const Run *run, Interval *of, const Point *at, long l) {
  const double *now = run->t + of->k * run->n + of->lane;
  double *count = run->counts + of->k * run->n + of->lane, needed, reason = COMPLETE;
  if (++of->k < run->m) {
    of->span = now[run->n] - *now;
    of->shortest = of->span / (run->graded ? 2 * (halvings(run->graded) - 1) : 2);
    if (run->last < of->shortest) of->shortest = run->last;
    of->step = of->attempt = 0;
    needed = at->speed[l] * of->span / run->length;
    if (run->tries > 0 && needed <= run->fastest) {
      needed = needed > 1 ? ceil(needed - 1e-9) : 1;
      *count = needed < run->longest ? needed : run->longest;
    }
    of->count = *count;
    if (of->count > 0 && of->count <= run->fastest) return 1;
    reason = of->count > 0 ? UNSOLVED : TOO_FAST;
  }
  finish(run, of->lane, of->k, *now, reason, at->state, at->state, of->h, l);
  return 0;
}

/* Begin the next attempt to reach a sample, with shorter steps; return whether there is one. */
static int next_attempt(const Run *run, Interval *of) {
  do {
    if (++of->attempt >= run->tries) return 0;
    of->count *= run->finer;
    run->counts[(of->k - 1) * run->n + of->lane] = of->count;
  } while (of->count > run->fastest);
  of->step = 0;
  return 1;
}

/* Correct the starts of the lanes of a vector, `from` to at most `to`, and store their first samples; return which
 * can move. */
static vl started(long from, long to, const Run *run, Point *start, const double *K, const Cells *cells) {
  long n = run->n, m = run->m;
  vd given[ROWS], placed[ROWS], r[CHECKED_RESULTS];
  vl single = (vl)SPLAT(0.0), solved, alive;
  Ends ends;
  memset(r, 0, sizeof r); /* without limits, all distances are zero */
  memset(start, 0, sizeof *start);
  for (int i = 0; i < ROWS; i++) ends.beyond[i] = given[i] = start->state[i] = load(run->in + i * n + from, to - from);
  for (int i = 0; i < INPUTS && m > 1; i++)
    start->state[FIRST_INPUT + i] = load(run->inputs + i * (m - 1) * n + from, to - from);
  ends.time = start->state[TIME] = load(run->t + from, to - from);
  ends.reason = SPLAT(UNSOLVED);
  solved = checked_at(start->state, start->rates, r, run->most, run->worst, run->repeats, K, cells);
  alive = inside(solved, start->state, r, run->rounding, &ends);
  start->speed = r[SPEED];
  memcpy(placed, start->state, sizeof placed);
  if (run->certified) single = placed_at(run, alive, placed, K, cells);
  for (long l = 0; l < LANES && from + l < to; l++) {
    if (!alive[l]) finish(run, from + l, 0, ends.time[l], ends.reason[l], ends.beyond, given, 0, l);
    else record(run, from + l, 0, start, placed, l);
    if (single[l]) run->doubt[(from + l) * m] = 0;
  }
  return alive;
}

/* Drive lanes `from` to `to`.
 *
 * No lane waits for others: each lane of a vector has its own interval and step, and a lane that ends is replaced by
 * the next one.
 */
void drive(long from, long to, const Run *run, const double *K, const Cells *cells) {
  long n = run->n, m = run->m, next = from;
  double halves = halvings(run->graded) - 1;
  Interval of[LANES];
  Point start, at, begun, end; /* `begun` is at the last sample, `end` at the end of the step */
  vl alive = started(from, to, run, &start, K, cells), none = (vl)SPLAT(0.0), single = none, solved;
  const vd *sample = end.state;
  vd placed[ROWS], r[CHECKED_RESULTS], mean[MOVING], h = SPLAT(0.0);
  Ends ends;
  memset(r, 0, sizeof r);
  at = begun = end = start;
  for (long l = 0; l < LANES; l++) of[l].lane = -1;
  for (;;) {
    vl busy = none, here = none, accepted = none;
    for (long l = 0; l < LANES; l++) {
      while (of[l].lane < 0 && next < to) {
        long i = (next - from) % LANES;
        if (i == 0 && next > from) alive = started(next, to, run, &start, K, cells);
        if (alive[i]) {
          of[l] = (Interval){next};
          assign_lane(&at, l, &start, i);
          assign_lane(&begun, l, &start, i);
          if (!next_interval(run, of + l, &at, l)) of[l].lane = -1;
        }
        next++;
      }
      if (of[l].lane < 0) continue;
      busy[l] = -1;
      of[l].step++;
      double past = of[l].step - of[l].count; /* graded steps are each half as long as the one before */
      here[l] = -(past >= run->graded);
      of[l].h = past > 0 ? of[l].shortest * halvings(run->graded - past)
                         : (of[l].span - halves * of[l].shortest) / of[l].count;
      h[l] = of[l].h;
    }
    if (!any(busy)) return;
    solved = stepped(end.state, at.state, at.rates, h, mean, r, run->most, run->worst, K, cells);
#if BEFORE
    memcpy(end.state + FIRST_BEFORE, end.state + FIRST_INPUT, INPUTS * sizeof h);
#endif
    for (long l = 0; l < LANES; l++) {
      if (!here[l]) continue;
      end.state[TIME][l] = run->t[of[l].k * n + of[l].lane];
      for (int i = 0; i < INPUTS && of[l].k < m - 1; i++)
        end.state[FIRST_INPUT + i][l] = run->inputs[(i * (m - 1) + of[l].k) * n + of[l].lane];
    }
    solved &= checked_at(end.state, end.rates, r, run->most, run->worst, run->repeats, K, cells);
    accepted = inside(busy & solved, end.state, r, run->rounding, &ends);
    end.speed = r[SPEED];
#if BEFORE
    if (run->estimated) add_errors(&at, mean, r + NEW_BEFORE_AT, h, end.errors, K, cells);
#endif
    for (long l = 0; l < LANES; l++) {
      if (!busy[l] || accepted[l]) continue;
      if (solved[l]) {
        finish(run, of[l].lane, of[l].k, ends.time[l], ends.reason[l], ends.beyond, at.state, h[l], l);
        of[l].lane = -1;
      } else if (next_attempt(run, of + l)) {
        assign_lane(&at, l, &begun, l);
      } else {
        double before = run->t[(of[l].k - 1) * n + of[l].lane];
        finish(run, of[l].lane, of[l].k, before, UNSOLVED, at.state, at.state, h[l], l);
        of[l].lane = -1;
      }
    }
    assign(accepted, &at, &end);
    here &= accepted;
    assign(here, &begun, &end);
    if (run->certified && any(here)) {
      memcpy(placed, end.state, sizeof placed);
      single = placed_at(run, here, placed, K, cells);
      sample = placed;
    }
    for (long l = 0; l < LANES; l++) {
      if (!here[l]) continue;
      record(run, of[l].lane, of[l].k, &end, sample, l);
      if (single[l]) run->doubt[of[l].lane * m + of[l].k] = 0;
      if (!next_interval(run, of + l, &at, l)) of[l].lane = -1;
    }
  }
}
