/* Motions of lanes in fixed steps, as `advance` and `_drive` of motion.py compute them without a
 * compiler. The macros are rows of the states and of the results of the graphs.
 *
 * `rates` are the derivatives at the states. After `counts` steps of length `h`, the positions are
 * predicted, not yet corrected. Lanes `from` to `to` of n are computed. The last row of `out` is 1 for lanes whose corrections stayed small.
 */
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

#ifdef LAG
/* The damping of two linearly implicit half steps is complete for infinitely stiff contacts. */
static vl stepped(vd *s, const vd *a, const vd *k1, vd h, vd *mean, vd *r, double most, double worst,
                  const double *K, const Cells *cells) {
  vd start[MOVING], half = SPLAT(0.5) * h, middle[MOVING];
  (void)k1; (void)mean; /* of another lag */
  memcpy(s, a, ROWS * sizeof *s);
  s[LAG] = half;
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
  s[LAG] = SPLAT(0.0);
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
    for (int i = NEW_FORCES; i < CHECKED_RESULTS; i++) r[i] = pick(rough, more[i], r[i]);
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
  for (int i = FIRST_DISTANCE; i < CHECKED_RESULTS; i++) {
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

/* Add the errors of a step of lanes: the integral of the defect on the cubic path by the 3/8 rule.
 *
 * `k1` and `k2` are the rates at both ends, `end` is the end. The errors of x and y get the part
 * that is due to the error of the heading when the path is turned about its origin; at any later
 * point the error of the heading times its coordinates is to be subtracted.
 */
static void add_errors(const vd *a, const vd *k1, const vd *mean, const vd *end, const vd *k2, vd h, vl lanes,
                       vd *sums, const double *K, const Cells *cells) {
  vd z[ROWS], r[RESULTS], e[STATES];
  for (int i = 0; i < STATES; i++) e[i] = SPLAT(0.125) * (k1[i] + k2[i]) - mean[i];
  for (int j = 1; j < 3; j++) {
    double c = j / 3.0, d = 1 - c;
    memcpy(z, a, sizeof z);
    for (int i = 0; i < MOVING; i++)
      z[i] = a[i] + h * (splat(c * d * d) * k1[i] + splat(c * c * (3 - 2 * c)) * mean[i] - splat(c * c * d) * k2[i]);
    z[TIME] = a[TIME] + splat(c) * h;
    eval_motion(z, r, K, cells);
    for (int i = 0; i < STATES; i++) e[i] = e[i] + SPLAT(0.375) * r[i];
  }
  for (int i = 0; i < STATES; i++) e[i] = h * e[i];
  e[X_ROW] = e[X_ROW] + e[HEADING_ROW] * end[Y_ROW];
  e[Y_ROW] = e[Y_ROW] - e[HEADING_ROW] * end[X_ROW];
  for (int i = 0; i < STATES; i++) sums[i] = pick(lanes, sums[i] + e[i], sums[i]);
}

/* Lanes of a row in an order; the last lane is repeated beyond the end. */
static inline vd gather(const double *row, const long *order, long n) {
  vd r;
  for (int l = 0; l < LANES; l++) r[l] = row[order[l < n ? l : n - 1]];
  return r;
}
static inline void scatter(double *row, const long *order, vd r, long n) {
  for (int l = 0; l < LANES && l < n; l++) row[order[l]] = r[l];
}

/* Motions over m samples at times t (m, n), as `_drive_plainly` of motion.py.
 *
 * `samples` has the shape (m, width, n): `kept` rows of states, then estimated errors if wanted. `counts` (m - 1, n) are
 * the numbers of steps; they are given if `tries` is zero. They are followed by `graded` steps, each of half the length
 * of the one before, to `last`. `out` has the rows time and reason of the
 * ends, states there, states and length of the last step.
 */
void drive(long from, long to, long n, const long *order, const double *in, const double *inputs, long m,
           const double *t, long kept, double length, double longest, double tries, double finer, double estimated,
           double rounding, double repeats, double fastest, double graded, double last, double most, double worst,
           double *samples,
           double *counts, double *out, const double *K, const Cells *cells) {
  vd a[ROWS], b[ROWS], s[ROWS], from_state[ROWS], r[CHECKED_RESULTS];
  vd rates[MOVING], first[MOVING], k1[MOVING], k2[MOVING], from_rates[MOVING], mean[MOVING], sums[STATES], begun[STATES];
  vd nothing = SPLAT(0.0) / SPLAT(0.0), speed = SPLAT(0.0), count = SPLAT(1.0), h = SPLAT(0.0);
  int given = tries == 0;
  long width = estimated ? kept + STATES : kept;
  memset(r, 0, sizeof r); /* without limits, all distances are zero */
  for (long g = from; g < to; g += LANES) {
    const long *own = order + g;
    vl every = ~(vl)SPLAT(0.0), alive = every;
    Ends ends = {gather(t + (m - 1) * n, own, n - g), splat(COMPLETE)};
    for (int i = 0; i < ROWS; i++) ends.beyond[i] = from_state[i] = b[i] = gather(in + i * n, own, n - g);
    for (int i = 0; i < STATES; i++) sums[i] = SPLAT(0.0);
    for (int i = 0; i < MOVING; i++) from_rates[i] = rates[i] = SPLAT(0.0);
    memcpy(a, b, sizeof a);
    for (long k = 0; k < m; k++) { /* from sample k - 1 to sample k */
      vd now = gather(t + k * n, own, n - g), before = gather(t + (k ? k - 1 : 0) * n, own, n - g), span = now - before;
      double halves = ldexp(1.0, (int)graded) - 1;
      vd shortest = vmin(splat(last), span / splat(2 * fmax(halves, 1)));
      vl open = alive;
      vd used = SPLAT(0.0);
      if (k) {
        vd needed = speed * span / splat(length);
        count = given ? gather(counts + (k - 1) * n, own, n - g)
                      : vmin(vmax(vceil(needed - SPLAT(1e-9)), SPLAT(1.0)), splat(longest));
        vl fast = given ? count == SPLAT(0.0) : ~(needed <= splat(fastest));
        ends.reason = pick(open & fast, splat(TOO_FAST), ends.reason);
        ends.time = pick(open & fast, before, ends.time);
        open &= ~fast;
      }
      memcpy(b, a, sizeof b);
      memcpy(first, rates, sizeof first);
      memcpy(begun, sums, sizeof begun);
      for (double attempt = 0; any(open) && attempt < (k && !given ? tries : 1); attempt++) {
        vl going = open & (count <= splat(fastest)), lost = open & ~going;
        double steps = 0;
        if (k) {
          for (int l = 0; l < LANES; l++) steps = going[l] ? fmax(steps, count[l] + graded) : steps;
          used = pick(open, count, used);
        }
        for (int i = 0; i < ROWS; i++) a[i] = pick(open, b[i], a[i]);
        for (int i = 0; i < MOVING; i++) k1[i] = pick(open, first[i], k1[i]);
        for (int i = 0; i < STATES; i++) sums[i] = pick(open, begun[i], sums[i]);
        vl arrived = k ? ~every : going;
        for (double step = 1; step <= steps && any(going); step++) {
          vd next = (span - splat(halves) * shortest) / count;
          for (int l = 0; l < LANES; l++)
            next[l] = step > count[l] ? ldexp(shortest[l], (int)(graded - step + count[l])) : next[l];
          h = pick(going, next, h);
          for (int i = 0; i < ROWS; i++) from_state[i] = pick(going, a[i], from_state[i]);
          for (int i = 0; i < MOVING; i++) from_rates[i] = pick(going, k1[i], from_rates[i]);
          vl solved = stepped(s, from_state, from_rates, h, mean, r, most, worst, K, cells);
          for (int i = 0; i < ROWS; i++) a[i] = pick(going, s[i], a[i]);
          lost |= going & ~solved;
          going &= solved;
          vl here = going & (count + splat(graded) <= splat(step));
          arrived |= here;
          going &= ~here;
          if (any(going)) {
            memcpy(s, a, sizeof s);
            solved = checked_at(s, k2, r, most, worst, repeats, K, cells);
            lost |= going & ~solved;
            going = inside(going & solved, s, r, rounding, &ends);
            for (int i = 0; i < ROWS; i++) a[i] = pick(going, s[i], a[i]);
            for (int i = 0; i < MOVING; i++) k1[i] = pick(going, k2[i], k1[i]);
          }
          if (estimated && any(here)) { /* with the inputs of this interval */
            memcpy(s, a, sizeof s);
            eval_motion(s, r, K, cells);
            for (int i = 0; i < MOVING; i++) k1[i] = pick(here, r[i], k1[i]);
          }
          if (estimated) add_errors(from_state, from_rates, mean, a, k1, h, going | here, sums, K, cells);
        }
        memcpy(s, a, sizeof s);
        s[TIME] = now;
        if (k < m - 1)
          for (int i = 0; i < INPUTS; i++) s[FIRST_INPUT + i] = gather(inputs + (i * (m - 1) + k) * n, own, n - g);
        vl solved = checked_at(s, k1, r, most, worst, repeats, K, cells);
        lost |= arrived & ~solved;
        arrived = inside(arrived & solved, s, r, rounding, &ends);
        for (int i = 0; i < ROWS; i++) a[i] = pick(arrived, s[i], a[i]);
        for (int i = 0; i < MOVING; i++) rates[i] = pick(arrived, k1[i], rates[i]);
        speed = pick(arrived, r[SPEED], speed);
        count = pick(lost, count * splat(finer), count);
        open = lost;
      }
      if (k && !given) scatter(counts + (k - 1) * n, own, used, n - g);
      ends.time = pick(open, before, ends.time);
      ends.reason = pick(open, splat(UNSOLVED), ends.reason);
      alive = ends.reason == splat(COMPLETE);
      double *row = samples + k * width * n;
      for (int i = 0; i < kept; i++) scatter(row + i * n, own, pick(alive, a[i], nothing), n - g);
      for (int i = 0; i < width - kept; i++) {
        vd e = sums[i];
        if (i == X_ROW) e = e - sums[HEADING_ROW] * a[Y_ROW];
        if (i == Y_ROW) e = e + sums[HEADING_ROW] * a[X_ROW];
        scatter(row + (kept + i) * n, own, pick(alive, e, nothing), n - g);
      }
    }
    double *row = out;
    scatter(row, own, ends.time, n - g);
    scatter(row += n, own, ends.reason, n - g);
    for (int i = 0; i < ROWS; i++) scatter(row += n, own, ends.beyond[i], n - g);
    for (int i = 0; i < ROWS; i++) scatter(row += n, own, from_state[i], n - g);
    scatter(row += n, own, h, n - g);
  }
}
