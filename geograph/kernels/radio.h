/*
Arrivals, and differences of arrival time and frequency: families/rays.py with its two modules, the
equations of factors/arrival.py and factors/difference.py, and the sums of what shares unknowns.
*/

/* Blocks of a path's basis: 2 m of a kinematic path, 8 of a fall (path.py). */
#define MOST_WEIGHTS 8

typedef struct {
    Size knots, order, width; /* order 0: a fall */
    const double *knots_s, *basis, *hermite, *miss;
} Way;

typedef struct {
    Size interval;
    double by_place[MOST_WEIGHTS], by_rate[MOST_WEIGHTS], place[3], rate[3];
} OnWay;

/* Weights of position and velocity. */
INLINE void both_weights(Size order, const double *hermite, double step, double offset,
                         double *place, double *rate)
{
    weights(order, 1, hermite, step, offset, place, rate);
}

/* Where an object is at a time; the interval found last is the first guess. */
INLINE void read_way(const Way *way, double time, OnWay *found)
{
    Size width = way->width;
    if (way->knots == 1) {
        memset(found, 0, sizeof *found);
        found->by_place[0] = 1.0;
    } else {
        Size at = found->interval = find(way->knots_s, way->knots, time, found->interval);
        double step = way->knots_s[at + 1] - way->knots_s[at], offset = time - way->knots_s[at];
        if (way->order == 0) {
            double miss[4], slope[4];
            both_weights(3, way->hermite, step, offset, found->by_place, found->by_rate);
            both_weights(2, way->miss, step, offset, miss, slope);
            for (int j = 0; j < 2; j++) {
                found->by_place[3 + j] -= miss[2 + j];
                found->by_rate[3 + j] -= slope[2 + j];
                found->by_place[6 + j] = miss[2 + j];
                found->by_rate[6 + j] = slope[2 + j];
            }
        } else
            both_weights(way->order, way->hermite, step, offset, found->by_place, found->by_rate);
    }
    const double *basis = way->basis + found->interval * width * 3;
    for (int j = 0; j < 3; j++)
        found->place[j] = found->rate[j] = 0.0;
    for (Size b = 0; b < width; b++)
        for (int j = 0; j < 3; j++) {
            found->place[j] += found->by_place[b] * basis[3 * b + j];
            found->rate[j] += found->by_rate[b] * basis[3 * b + j];
        }
}

/* families/differences.py: _acceleration. */
static inline void acceleration_on(const Way *way, double time, const OnWay *now, double *value)
{
    memset(value, 0, 3 * sizeof *value);
    if (way->knots == 1)
        return;
    double low = way->knots_s[now->interval], length = way->knots_s[now->interval + 1] - low;
    double early = fmax(time - 1e-4 * length, low);
    double late = fmin(time + 1e-4 * length, low + length);
    if (!(late > early))
        return;
    OnWay before = {.interval = now->interval}, after = {.interval = now->interval};
    read_way(way, early, &before);
    read_way(way, late, &after);
    for (int j = 0; j < 3; j++)
        value[j] = (after.rate[j] - before.rate[j]) / (late - early);
}

/* Sensors as pieces of cubics: piece p of sensor s is number first[s] + p, from edges[] on. */
typedef struct {
    Size sensors, pieces;
    const int64_t *first;
    const double *edges, *parts;
} Movers;

typedef struct {
    Size e;
    const int64_t *sensor, *first, *channel, *column, *target;
    const double *basis, *chains;
    double *delay, *by_channel;
} End;

enum { ARRIVALS = 0, TIME_DIFFERENCES = 1, FREQUENCY_DIFFERENCES = 2 };
enum { FREQUENCY = 9 };

typedef struct {
    Size kind, n, g, ends, constants, entries;
    int rounds, known;
    double speed_m_s, spin_rad_s, enough;
    Way way;
    Movers movers;
    End end[2];
    const int64_t *start;
    const double *measured, *time, *sigma, *white, *carrier, *relative, *values;
    double *emitted, *residual, *by_common, *by_position, *by_velocity, *by_constants;
    double *by_place, *by_rate;
    int64_t *interval;
    double *errors[2], *work;
    Size stride[2]; /* from a row's errors to the next one's: 0 where none are estimated */
} Radio;

typedef struct {
    double tau, distance, unit[3], turned[3], velocity[3], inertial[3], sensor_inertial[3];
    double sensor[3], sensor_velocity[3], sensor_acceleration[3], speed, sine, cosine;
} Ray;

INLINE void turn(double sine, double cosine, const double *vector, double *turned)
{
    double x = vector[0], y = vector[1];
    turned[0] = cosine * x + sine * y;
    turned[1] = cosine * y - sine * x;
    turned[2] = vector[2];
}

/* sensors.py: Trajectory.motion_at, with the sensor's estimated errors. */
INLINE Size move(const Movers *movers, Size sensor, double time, Size piece,
                        const double *errors, Ray *ray)
{
    Size first = (Size)movers->first[sensor], count = (Size)movers->first[sensor + 1] - first;
    const double *edges = movers->edges + first;
    if (piece < 0 || piece >= count || !(time >= edges[piece] || piece == 0) ||
        !(piece + 1 == count || time < edges[piece + 1])) {
        Size low = 0, high = count;
        while (low < high) {
            Size middle = (low + high) / 2;
            if (edges[middle] <= time)
                low = middle + 1;
            else
                high = middle;
        }
        piece = low > 0 ? low - 1 : 0;
    }
    double offset = time - edges[piece];
    const double *part = movers->parts + 12 * (first + piece);
    for (int j = 0; j < 3; j++) {
        double third = part[j], second = part[3 + j], rate = part[6 + j];
        ray->sensor[j] = ((third * offset + second) * offset + rate) * offset + part[9 + j] +
                         errors[POSITION + j];
        ray->sensor_velocity[j] =
            (3.0 * third * offset + 2.0 * second) * offset + rate + errors[VELOCITY + j];
        ray->sensor_acceleration[j] = 6.0 * third * offset + 2.0 * second;
    }
    return piece;
}

#define TRACE_ROUNDS 50

/* A last step that bends the signal by no more than this meets it within its tolerance. */
#define STRAIGHT_M 1e-10

/* factors/arrival.py: trace, of one signal; starts from the last delay, and keeps the new one. The
   delay of a rough one is as good; all else is of before the last step. */
INLINE void trace(const Radio *all, const End *end, Size i, const double *errors, double emitted,
                  const OnWay *object, int rough, Ray *ray)
{
    double tau = end->delay[i], spin = all->spin_rad_s, speed = all->speed_m_s + errors[SPEED];
    Size piece = -1, sensor = (Size)end->sensor[i];
    if (!isfinite(tau))
        tau = 0.0;
    ray->speed = speed;
    ray->sine = 0.0;
    ray->cosine = 1.0;
    memcpy(ray->turned, object->place, sizeof ray->turned);
    for (int round = 0; round < TRACE_ROUNDS; round++) {
        double line[3], total = 0.0;
        piece = move(&all->movers, sensor, emitted + tau, piece, errors, ray);
        if (spin != 0.0) {
            ray->sine = sin(spin * tau);
            ray->cosine = cos(spin * tau);
            turn(ray->sine, ray->cosine, object->place, ray->turned);
        }
        for (int j = 0; j < 3; j++) {
            line[j] = ray->turned[j] - ray->sensor[j];
            total += line[j] * line[j];
        }
        ray->distance = sqrt(total);
        double inverse = 1.0 / (ray->distance > 1e-300 ? ray->distance : 1e-300);
        for (int j = 0; j < 3; j++)
            ray->unit[j] = line[j] * inverse;
        ray->sensor_inertial[0] = ray->sensor_velocity[0] - spin * ray->sensor[1];
        ray->sensor_inertial[1] = ray->sensor_velocity[1] + spin * ray->sensor[0];
        ray->sensor_inertial[2] = ray->sensor_velocity[2];
        double change =
            (ray->distance - speed * tau) / (speed + dot(ray->unit, ray->sensor_inertial));
        if (fabs(change) * speed <= 1e-9 + 1e-15 * ray->distance)
            break;
        double next = tau + change;
        tau = next < 0.0 ? 0.0 : next;
        if (isnan(tau))
            break;
        if (rough && tau > 0.0) {
            const double *w = ray->sensor_inertial, *a = ray->sensor_acceleration;
            double bend = dot(w, w) * inverse + fabs(a[0]) + fabs(a[1]) + fabs(a[2]) + 0.1;
            if (change * change * bend <= STRAIGHT_M)
                break;
        }
    }
    ray->tau = end->delay[i] = tau;
    turn(ray->sine, ray->cosine, object->rate, ray->velocity);
    ray->inertial[0] = ray->velocity[0] - spin * ray->turned[1];
    ray->inertial[1] = ray->velocity[1] + spin * ray->turned[0];
    ray->inertial[2] = ray->velocity[2];
}

/* Derivatives of one scalar of one ray (factors/arrival.py: Gradient); those by the object in the
   frame's axes at emission. */
typedef struct {
    double position[3], velocity[3], sensor[3], sensor_velocity[3], emission, speed;
} Slope;

/* factors/arrival.py: arrival_gradient. */
INLINE void arrival_slope(const Ray *ray, Slope *slope)
{
    double rate = ray->speed + dot(ray->unit, ray->sensor_inertial), by[3];
    memset(slope, 0, sizeof *slope);
    double inverse = 1.0 / rate;
    for (int j = 0; j < 3; j++) {
        by[j] = ray->unit[j] * inverse;
        slope->sensor[j] = -by[j];
    }
    turn(-ray->sine, ray->cosine, by, slope->position);
    slope->emission = (ray->speed + dot(ray->unit, ray->inertial)) * inverse;
    slope->speed = -ray->distance * inverse;
}

/* The same by the time of emission alone. */
INLINE double by_emission(const Ray *ray)
{
    return (ray->speed + dot(ray->unit, ray->inertial)) /
           (ray->speed + dot(ray->unit, ray->sensor_inertial));
}

INLINE const double *errors_of(const Radio *all, Size which, Size i)
{
    return all->errors[which] + i * all->stride[which];
}

/* factors/arrival.py: doppler. */
INLINE double doppler(const Ray *ray)
{
    double relative[3];
    for (int j = 0; j < 3; j++)
        relative[j] = ray->sensor_inertial[j] - ray->inertial[j];
    return dot(ray->unit, relative) / (ray->speed + dot(ray->unit, ray->inertial));
}

/* factors/arrival.py: doppler_gradient, times a factor. */
INLINE void doppler_slope(const Ray *ray, const Slope *delay, const double *acceleration,
                                 double spin, double factor, Slope *slope)
{
    const double *u = ray->unit, *v = ray->inertial, *own = ray->sensor_velocity;
    double ratio = doppler(ray) + 1.0, below = ray->speed + dot(u, v);
    double rate = ray->speed + dot(u, ray->sensor_inertial);
    double pull[3], by_line[3], by_object[3], by_sensor[3], turned[3], place[3];
    for (int j = 0; j < 3; j++)
        pull[j] = ray->sensor_inertial[j] - ratio * v[j];
    double along = dot(u, pull), far = ray->distance * below;
    for (int j = 0; j < 3; j++) {
        by_line[j] = (pull[j] - u[j] * along) / far;
        by_object[j] = -u[j] * (ratio / below);
        by_sensor[j] = u[j] / below;
    }
    double frame_turn[3] = {-spin * ray->turned[1] + own[0], spin * ray->turned[0] + own[1], own[2]};
    double turning[3] = {-spin * v[1], spin * v[0], 0.0};
    const double *a = ray->sensor_acceleration;
    double change[3] = {a[0] - spin * own[1], a[1] + spin * own[0], a[2]};
    double by_delay = -dot(by_line, frame_turn) - dot(by_object, turning) + dot(by_sensor, change);
    for (int j = 0; j < 3; j++) {
        turned[j] = by_line[j] + by_delay * u[j] / rate;
        place[j] = -by_line[j] + by_delay * delay->sensor[j];
    }
    /* V contains w x P, and W contains w x S. */
    turned[0] += spin * by_object[1];
    turned[1] -= spin * by_object[0];
    place[0] += spin * by_sensor[1];
    place[1] -= spin * by_sensor[0];
    double gap[3], push[3];
    turn(ray->sine, ray->cosine, acceleration, push);
    push[0] -= spin * ray->velocity[1];
    push[1] += spin * ray->velocity[0];
    for (int j = 0; j < 3; j++)
        gap[j] = ray->velocity[j] - own[j];
    slope->emission = factor * (dot(by_line, gap) + dot(by_object, push) + dot(by_sensor, change) +
                                by_delay * (delay->emission - 1.0));
    slope->speed = factor * (by_delay * delay->speed + ray->speed * (1.0 - ratio) / below);
    turn(-ray->sine, ray->cosine, turned, slope->position);
    turn(-ray->sine, ray->cosine, by_object, slope->velocity);
    for (int j = 0; j < 3; j++) {
        slope->position[j] *= factor;
        slope->velocity[j] *= factor;
        slope->sensor[j] = factor * place[j];
        slope->sensor_velocity[j] = factor * by_sensor[j];
    }
}

static int ascending(const void *one, const void *other)
{
    double a = *(const double *)one, b = *(const double *)other;
    return (a > b) - (a < b);
}

/* The median; the values are sorted. What is not a number is beyond all others. */
static double median(Size count, double *values)
{
    for (Size i = 0; i < count; i++)
        if (isnan(values[i]))
            values[i] = INFINITY;
    if (count > 24)
        qsort(values, (size_t)count, sizeof *values, ascending);
    else
        for (Size i = 1; i < count; i++) {
            double value = values[i];
            Size j = i;
            for (; j > 0 && values[j - 1] > value; j--)
                values[j] = values[j - 1];
            values[j] = value;
        }
    return 0.5 * (values[(count - 1) / 2] + values[count / 2]);
}

#define LEAST_RATE 0.05

/* families/arrivals.py: _emission_times. */
INLINE void emissions_of_arrivals(const Radio *all)
{
    const End *end = &all->end[0];
    double *late = all->work, *rate = late + all->n;
    OnWay object = {0};
    Ray ray;
    for (Size k = 0; !all->known && k < all->g; k++) {
        Size first = (Size)all->start[k], count = (Size)all->start[k + 1] - first;
        for (Size i = 0; i < count; i++)
            late[i] = all->measured[first + i] - errors_of(all, 0, first + i)[CLOCK];
        all->emitted[first] = median(count, late);
    }
    for (int round = 0; round < all->rounds; round++) {
        double most = 0.0;
        for (Size k = 0; k < all->g; k++) {
            Size first = (Size)all->start[k], count = (Size)all->start[k + 1] - first;
            double emitted = all->emitted[first];
            read_way(&all->way, emitted, &object);
            for (Size i = first; i < first + count; i++) {
                const double *errors = errors_of(all, 0, i);
                trace(all, end, i, errors, emitted, &object, 1, &ray);
                late[i - first] = all->measured[i] - errors[CLOCK] - ray.tau - emitted;
                rate[i - first] = by_emission(&ray);
            }
            double miss = median(count, late), by = median(count, rate);
            by = copysign(fmax(fabs(by), LEAST_RATE), by);
            double next = emitted + miss / by, moved = fabs(next - emitted);
            all->emitted[first] = next;
            /* What is not a number ends the search, as it does there. */
            if (moved > most || isnan(moved))
                most = moved;
            if (isnan(most))
                most = INFINITY;
        }
        if (!(most > all->enough) || isinf(most))
            break;
    }
}

/* families/differences.py: _emission_times, of one group. */
INLINE void emission_of_difference(const Radio *all, Size first, OnWay *object)
{
    const double *errors = errors_of(all, 1, first);
    double received = all->time[first] - errors[CLOCK];
    double emitted = all->known ? all->emitted[first] : received;
    Ray ray;
    for (int round = 0; round < all->rounds; round++) {
        read_way(&all->way, emitted, object);
        trace(all, &all->end[1], first, errors, emitted, object, 1, &ray);
        double step = (received - emitted - ray.tau) / by_emission(&ray);
        emitted += step;
        if (!(fabs(step) > all->enough + 4.0 * 2.220446049250313e-16 * fabs(emitted)))
            break;
    }
    all->emitted[first] = emitted;
}

static inline double spacing(double value)
{
    return nextafter(fabs(value), INFINITY) - fabs(value);
}

/* Write the derivatives of a row: by the path, by both ends' channels of error. */
INLINE void put_row(const Radio *all, Size i, const OnWay *object, const double *by_position,
                    const double *by_velocity, double (*channels)[CHANNELS])
{
    double white = all->white[i];
    Size width = all->way.width;
    for (int j = 0; j < 3; j++) {
        all->by_position[3 * i + j] = white * by_position[j];
        if (by_velocity != NULL)
            all->by_velocity[3 * i + j] = white * by_velocity[j];
    }
    memcpy(all->by_place + i * width, object->by_place, sizeof(double) * (size_t)width);
    if (all->by_rate != NULL)
        memcpy(all->by_rate + i * width, object->by_rate, sizeof(double) * (size_t)width);
    for (Size which = 0; which < all->ends; which++) {
        const End *end = &all->end[which];
        for (int j = 0; j < CHANNELS && end->by_channel != NULL; j++)
            end->by_channel[i * CHANNELS + j] = white * channels[which][j];
        for (Size k = (Size)end->first[i]; k < (Size)end->first[i + 1]; k++)
            all->by_constants[end->target[k]] +=
                white * channels[which][end->channel[k]] * end->basis[k];
    }
}

/* families/arrivals.py: residuals and derivatives of one emission. */
INLINE void arrivals_of(const Radio *all, Size k, OnWay *object)
{
    Size first = (Size)all->start[k];
    double emitted = all->emitted[first], coarse = spacing(emitted);
    double channels[1][CHANNELS] = {{0.0}};
    Ray ray;
    Slope slope;
    read_way(&all->way, emitted, object);
    for (Size i = first; i < (Size)all->start[k + 1]; i++) {
        const double *errors = errors_of(all, 0, i);
        trace(all, &all->end[0], i, errors, emitted, object, 0, &ray);
        arrival_slope(&ray, &slope);
        all->emitted[i] = emitted;
        all->interval[i] = object->interval;
        double gap = emitted - all->measured[i];
        if (coarse > all->sigma[i] && coarse > 16.0 * spacing(all->measured[i]))
            gap = NAN;
        all->residual[i] = all->white[i] * (gap + ray.tau + errors[CLOCK]);
        all->by_common[i] = all->white[i] * slope.emission;
        if (all->by_position == NULL)
            continue;
        channels[0][CLOCK] = 1.0;
        memcpy(channels[0] + POSITION, slope.sensor, sizeof slope.sensor);
        channels[0][SPEED] = slope.speed / ray.speed;
        put_row(all, i, object, slope.position, NULL, channels);
    }
}

/* families/differences.py: residuals and derivatives of what has one reference and time. */
INLINE void differences_of(const Radio *all, Size k, OnWay *object)
{
    Size first = (Size)all->start[k];
    int rates = all->kind == FREQUENCY_DIFFERENCES;
    emission_of_difference(all, first, object);
    const double emitted = all->emitted[first], *reference = errors_of(all, 1, first);
    Ray held, ray;
    Slope to_held, to_one, other, one, *own = rates ? &one : &to_one;
    double acceleration[3], shift = 0.0, carrier = NAN;
    read_way(&all->way, emitted, object);
    trace(all, &all->end[1], first, reference, emitted, object, 0, &held);
    arrival_slope(&held, &to_held);
    memset(&other, 0, sizeof other);
    if (rates && all->by_position != NULL)
        acceleration_on(&all->way, emitted, object, acceleration);
    if (rates)
        shift = doppler(&held);
    for (Size i = first; i < (Size)all->start[k + 1]; i++) {
        const double *errors = errors_of(all, 0, i);
        double channels[2][CHANNELS], by_position[3], by_velocity[3], by_reference[3], value;
        trace(all, &all->end[0], i, errors, emitted, object, 0, &ray);
        all->end[1].delay[i] = held.tau;
        all->emitted[i] = emitted;
        all->interval[i] = object->interval;
        if (rates)
            value = all->carrier[i] * (doppler(&ray) - shift) +
                    all->relative[i] * (errors[FREQUENCY] - reference[FREQUENCY]);
        else
            value = ray.tau - held.tau + (errors[CLOCK] - reference[CLOCK]);
        all->residual[i] = all->white[i] * (value - all->measured[i]);
        if (all->by_position == NULL)
            continue;
        arrival_slope(&ray, &to_one);
        if (rates) {
            doppler_slope(&ray, &to_one, acceleration, all->spin_rad_s, all->carrier[i], &one);
            if (carrier != all->carrier[i])
                doppler_slope(&held, &to_held, acceleration, all->spin_rad_s, -all->carrier[i],
                              &other);
            carrier = all->carrier[i];
        }
        /* At a later emission everything is later; the arrival at the reference is held. */
        double rate = (own->emission + other.emission) / to_held.emission;
        for (int j = 0; j < 3; j++) {
            by_position[j] = own->position[j] + other.position[j] - rate * to_held.position[j];
            by_velocity[j] = own->velocity[j] + other.velocity[j];
            by_reference[j] = other.sensor[j] - rate * to_held.sensor[j];
        }
        double by_speed = own->speed + other.speed - rate * to_held.speed;
        memset(channels, 0, sizeof channels);
        memcpy(channels[0] + POSITION, own->sensor, sizeof own->sensor);
        memcpy(channels[0] + VELOCITY, own->sensor_velocity, sizeof own->sensor_velocity);
        channels[0][SPEED] = by_speed / ray.speed;
        memcpy(channels[1] + POSITION, by_reference, sizeof by_reference);
        memcpy(channels[1] + VELOCITY, other.sensor_velocity, sizeof other.sensor_velocity);
        if (rates) {
            channels[1][CLOCK] = -rate;
            channels[0][FREQUENCY] = all->relative[i];
            channels[1][FREQUENCY] = -all->relative[i];
        } else {
            channels[0][CLOCK] = 1.0;
            channels[1][CLOCK] = -rate;
        }
        put_row(all, i, object, by_position, rates ? by_velocity : NULL, channels);
    }
}

/* Read the errors of all channels; families/rays.py: End.errors. */
static void read_errors(const Radio *all)
{
    for (Size which = 0; which < all->ends; which++) {
        const End *end = &all->end[which];
        double *errors = all->errors[which];
        if (all->stride[which] == 0) {
            memset(errors, 0, sizeof(double) * CHANNELS);
            continue;
        }
        if (end->chains != NULL)
            memcpy(errors, end->chains, sizeof(double) * (size_t)(all->n * CHANNELS));
        else
            memset(errors, 0, sizeof(double) * (size_t)(all->n * CHANNELS));
        for (Size i = 0; i < all->n; i++)
            for (Size k = (Size)end->first[i]; k < (Size)end->first[i + 1]; k++)
                errors[i * CHANNELS + end->channel[k]] +=
                    end->basis[k] * all->values[end->column[k]];
    }
}

WIDE static void radio_all(const Radio *all)
{
    OnWay object = {0};
    read_errors(all);
    if (all->by_constants != NULL)
        memset(all->by_constants, 0, sizeof(double) * (size_t)all->entries);
    if (all->kind == ARRIVALS)
        emissions_of_arrivals(all);
    for (Size k = 0; k < all->g; k++)
        if (all->kind == ARRIVALS)
            arrivals_of(all, k, &object);
        else
            differences_of(all, k, &object);
}

/* Whether indices grow from 0 to the last by steps of at least so much. */
static int grows(Size count, const int64_t *index, int64_t last, int64_t least)
{
    int fits = index[0] == 0 && index[count] == last;
    for (Size i = 0; i < count; i++)
        fits &= index[i + 1] >= index[i] + least;
    return fits;
}

static int within(Size count, const int64_t *index, Size end)
{
    int fits = 1;
    for (Size i = 0; i < count; i++)
        fits &= index[i] >= 0 && index[i] < end;
    return fits;
}

static int radio_fits(const Radio *all)
{
    const Movers *movers = &all->movers;
    int fits = grows(all->g, all->start, all->n, 1) &&
               grows(movers->sensors, movers->first, movers->pieces, 1);
    for (Size which = 0; which < all->ends; which++) {
        const End *end = &all->end[which];
        fits = fits && grows(all->n, end->first, end->e, 0) &&
               within(all->n, end->sensor, movers->sensors) &&
               within(end->e, end->channel, CHANNELS) &&
               within(end->e, end->column, all->constants) &&
               within(end->e, end->target, all->entries);
    }
    return fits;
}

/* All that a solve does not change: checked once, and held until the capsule goes. */
typedef struct {
    Reader reader;
    Radio all;
    const int64_t *row, *column;
    Size *first, *entry;
} Plan;

#define PLAN "geograph.kernels.radio_plan"

static void drop(Plan *plan)
{
    release(&plan->reader);
    free(plan->first);
    free(plan);
}

static void drop_capsule(PyObject *capsule)
{
    Plan *plan = PyCapsule_GetPointer(capsule, PLAN);
    if (plan != NULL)
        drop(plan);
}

static int read_end(Reader *reader, const Radio *all, End *end)
{
    end->e = whole(reader);
    end->sensor = integers(reader, all->n);
    end->first = integers(reader, all->n + 1);
    end->channel = integers(reader, end->e);
    end->column = integers(reader, end->e);
    end->target = integers(reader, end->e);
    end->basis = reals(reader, end->e);
    return end->sensor && end->first && end->channel && end->column && end->target && end->basis;
}

static PyObject *radio_plan(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Plan *plan = calloc(1, sizeof *plan);
    if (plan == NULL)
        return PyErr_NoMemory();
    Reader *reader = &plan->reader;
    Radio *all = &plan->all;
    start(reader, arguments, given);
    all->kind = whole(reader);
    all->rounds = (int)whole(reader);
    Size n = all->n = whole(reader), g = all->g = whole(reader);
    all->constants = whole(reader);
    Size entries = all->entries = whole(reader);
    all->movers.sensors = whole(reader);
    all->movers.pieces = whole(reader);
    all->speed_m_s = number(reader);
    all->spin_rad_s = number(reader);
    all->enough = number(reader);
    if (!reader->failed && all->kind > FREQUENCY_DIFFERENCES) {
        PyErr_SetString(PyExc_ValueError, "expected kind 0, 1 or 2");
        reader->failed = 1;
    }
    all->ends = all->kind == ARRIVALS ? 1 : 2;
    all->start = integers(reader, g + 1);
    all->movers.first = integers(reader, all->movers.sensors + 1);
    all->movers.edges = reals(reader, all->movers.pieces);
    all->movers.parts = reals(reader, 12 * all->movers.pieces);
    all->measured = reals(reader, n);
    all->time = reals(reader, n);
    all->sigma = reals(reader, n);
    all->carrier = reals(reader, n);
    all->relative = reals(reader, n);
    plan->row = integers(reader, entries);
    plan->column = integers(reader, entries);
    int there = all->start && all->movers.first && all->movers.edges && all->movers.parts &&
                all->measured && all->time && all->sigma && plan->row && plan->column &&
                (all->kind != FREQUENCY_DIFFERENCES || (all->carrier && all->relative));
    for (Size which = 0; which < all->ends; which++)
        there = read_end(reader, all, &all->end[which]) && there;
    if (!complete(reader, there)) {
        drop(plan);
        return NULL;
    }
    plan->first = malloc(sizeof(Size) * (size_t)(n + 2 + entries));
    if (plan->first == NULL) {
        drop(plan);
        return PyErr_NoMemory();
    }
    plan->entry = plan->first + n + 2;
    if (!radio_fits(all) || !within(entries, plan->column, all->constants) ||
        !by_row(n, entries, plan->row, plan->first, plan->entry)) {
        PyErr_SetString(PyExc_IndexError, "a group, sensor or entry is out of range");
        drop(plan);
        return NULL;
    }
    PyObject *capsule = PyCapsule_New(plan, PLAN, drop_capsule);
    if (capsule == NULL)
        drop(plan);
    return capsule;
}

/* A plan, and where a call's own arrays go; the rest of them is read as the caller needs it. */
static const Plan *planned(Reader *reader, Radio *all)
{
    PyObject *capsule = following(reader);
    const Plan *plan = capsule == NULL ? NULL : PyCapsule_GetPointer(capsule, PLAN);
    if (plan == NULL) {
        reader->failed = 1;
        memset(all, 0, sizeof *all);
        return NULL;
    }
    *all = plan->all;
    return plan;
}

static int read_point(Reader *reader, Radio *all)
{
    Way *way = &all->way;
    way->knots = whole(reader);
    way->order = whole(reader);
    if (!reader->failed && (way->order > MOST_ORDER || way->knots < 1)) {
        PyErr_SetString(PyExc_ValueError, "expected 0 to 3 blocks and a knot");
        reader->failed = 1;
    }
    way->width = way->order ? 2 * way->order : MOST_WEIGHTS;
    way->knots_s = reals(reader, way->knots);
    way->basis = reals(reader, (way->knots > 1 ? way->knots - 1 : 1) * way->width * 3);
    way->hermite = reals(reader, way->order ? 4 * way->order * way->order : 36);
    way->miss = reals(reader, 16);
    all->known = (int)whole(reader);
    all->white = reals(reader, all->n);
    all->values = reals(reader, all->constants);
    all->emitted = results(reader, all->n);
    for (Size which = 0; which < all->ends; which++)
        if ((all->end[which].delay = results(reader, all->n)) == NULL)
            return 0;
    return way->knots_s && way->basis && way->hermite && (way->miss || way->order) &&
           all->white && all->values && all->emitted;
}

/* Make room for the errors of all channels; 0 without memory. */
static int room_for_errors(Radio *all)
{
    Size room[2] = {0, 0}, n = all->n;
    for (Size which = 0; which < all->ends; which++) {
        int estimated = all->end[which].e || all->end[which].chains != NULL;
        all->stride[which] = estimated ? CHANNELS : 0;
        room[which] = estimated ? n * CHANNELS : CHANNELS;
    }
    all->errors[0] = malloc(sizeof(double) * (size_t)(room[0] + room[1] + 2 * n));
    if (all->errors[0] == NULL) {
        PyErr_NoMemory();
        return 0;
    }
    all->errors[1] = all->errors[0] + room[0];
    all->work = all->errors[1] + room[1];
    return 1;
}

static PyObject *radio(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Radio all;
    start(&reader, arguments, given);
    planned(&reader, &all);
    Size n = all.n;
    int there = read_point(&reader, &all), finite = 1;
    for (Size which = 0; which < all.ends; which++) {
        all.end[which].chains = reals(&reader, n * CHANNELS);
        all.end[which].by_channel = results(&reader, n * CHANNELS);
    }
    all.residual = results(&reader, n);
    all.interval = whole_results(&reader, n);
    all.by_common = results(&reader, n);
    all.by_position = results(&reader, 3 * n);
    all.by_velocity = results(&reader, 3 * n);
    all.by_place = results(&reader, n * all.way.width);
    all.by_rate = results(&reader, n * all.way.width);
    all.by_constants = results(&reader, all.entries);
    there = there && all.residual && all.interval && (all.kind != ARRIVALS || all.by_common);
    if (all.by_position != NULL)
        there = there && all.by_constants && all.by_place &&
                ((all.by_velocity && all.by_rate) || all.kind != FREQUENCY_DIFFERENCES);
    if (!complete(&reader, there) || !room_for_errors(&all)) {
        release(&reader);
        return NULL;
    }
    Py_BEGIN_ALLOW_THREADS
    radio_all(&all);
    for (Size i = 0; i < n; i++)
        finite &= isfinite(all.emitted[i]) != 0;
    Py_END_ALLOW_THREADS
    free(all.errors[0]);
    release(&reader);
    return PyBool_FromLong(finite);
}

/* ---------------------------------------------------------------------------------- shared */

static inline Size end_of(Size groups, const int64_t *start, Size k, Size n)
{
    return k + 1 < groups ? (Size)start[k + 1] : n;
}

/* Whether groups, given by their first rows, cover all rows, none of them empty. */
static int covers(Size groups, const int64_t *start, Size n)
{
    int fits = groups ? start[0] == 0 : n == 0;
    for (Size k = 0; k < groups; k++)
        fits &= start[k] < end_of(groups, start, k, n);
    return fits;
}

/* common.py: settled, where no loss asks for weights of its own. Without values before they are 0. */
static void settle_all(Size groups, const int64_t *first, Size n, const double *residual,
                       const double *slope, const double *weight, const double *information,
                       const double *before, double *value, double *changed)
{
    for (Size k = 0; k < groups; k++) {
        Size end = end_of(groups, first, k, n);
        double pull = 0.0, hold = 0.0, start = before == NULL ? 0.0 : before[k];
        for (Size i = (Size)first[k]; i < end; i++) {
            double by = weight == NULL ? slope[i] : weight[i] * slope[i];
            pull += by * (residual[i] - slope[i] * start);
            hold += by * slope[i];
        }
        hold += information == NULL ? 0.0 : information[k];
        /* Where every measurement of a group is left out, nothing moves its unknown. */
        value[k] = hold > 0.0 ? -pull / hold : start;
        for (Size i = (Size)first[k]; i < end; i++)
            changed[i] = residual[i] + slope[i] * (value[k] - start);
    }
}

static PyObject *settle(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size n = whole(&reader), groups = whole(&reader);
    const int64_t *first = integers(&reader, groups);
    const double *residual = reals(&reader, n), *slope = reals(&reader, n);
    const double *weight = reals(&reader, n);
    const double *information = reals(&reader, groups), *before = reals(&reader, groups);
    double *value = results(&reader, groups), *changed = results(&reader, n);
    if (!complete(&reader,
                  first && residual && slope && information && before && value && changed)) {
        release(&reader);
        return NULL;
    }
    int fits = covers(groups, first, n);
    if (fits)
        settle_all(groups, first, n, residual, slope, weight, information, before, value, changed);
    release(&reader);
    if (!fits) {
        PyErr_SetString(PyExc_IndexError, "a group is empty or out of range");
        return NULL;
    }
    Py_RETURN_NONE;
}

/* Groups of rows of the same emission: with the same weights of their knots, or with an unknown of
   their own (by_common), or both. */
typedef struct {
    Size groups;
    const int64_t *start;
    const double *by_common, *information, *by_velocity, *rates;
    double *rows, *products, *taken, *by_knots;
    Size *column, *slot;
} Shared;

/* common.py: project, of the rows of one group, whose last column is the residual. */
INLINE void take_up(const Shared *shared, Size k, const double *slope, Size count, Size last,
                    Size pad)
{
    double square = 0.0, information = shared->information == NULL ? 0.0 : shared->information[k], *restrict taken = shared->taken;
    for (Size i = 0; i < count; i++)
        square += slope[i] * slope[i];
    double total = square + information;
    double root = total > 0.0 ? sqrt(information / total) : 1.0;
    double share = total > 0.0 ? 1.0 / (1.0 + root) / total : 0.0;
    double back = information > 0.0 ? -share / root : 0.0;
    memset(taken, 0, sizeof(double) * (size_t)pad);
    for (Size i = 0; i < count; i++) {
        const double *restrict row = shared->rows + i * pad;
        for (Size j = 0; j < pad; j++)
            taken[j] += slope[i] * row[j];
    }
    double residual = back * taken[last];
    for (Size j = 0; j < pad; j++)
        taken[j] *= share;
    taken[last] = residual;
    for (Size i = 0; i < count; i++) {
        double *restrict row = shared->rows + i * pad;
        for (Size j = 0; j < pad; j++)
            row[j] -= slope[i] * taken[j];
    }
}

/* Add products of the derivatives by position and velocity, the columns of a group's rows before
   all others, which its weights make those by the knots. */
INLINE void spread_out(Size order, int moves, const Blocks *all, const Shared *shared, Size first,
                       Size touched, Size pad, double *total)
{
    Size m = 3 * order, d = all->path + all->walks, halves = all->chained ? 2 : 1;
    Size lead = moves ? 6 : 3, knots = halves * d, full = knots + all->constants + 1;
    double place[6 * MOST_ORDER], rate[6 * MOST_ORDER], by_place[3 * MOST_ORDER];
    double by_rate[3 * MOST_ORDER], *restrict by = shared->by_knots;
    for (Size half = 0; half < 2; half++)
        for (Size c = 0; c < m; c++) {
            Size weight = 2 * order * first + half * order + c / 3;
            place[half * m + c] = all->weights[weight] * all->scale[c];
            rate[half * m + c] = moves ? shared->rates[weight] * all->scale[c] : 0.0;
        }
    for (Size a = 0; a < halves * m; a++) {
        const double *restrict one = shared->products + a % 3 * pad;
        const double *restrict two = one + (moves ? 3 * pad : 0);
        for (Size c = 0; c < pad; c++)
            by[c] = moves ? place[a] * one[c] + rate[a] * two[c] : place[a] * one[c];
        for (Size c = 0; c < m; c++) {
            by_place[c] = by[c % 3];
            by_rate[c] = moves ? by[3 + c % 3] : 0.0;
        }
        double *restrict row = total + (a / m * d + a % m) * full;
        for (Size half = 0; half < halves; half++)
            for (Size c = 0; c < m; c++)
                row[half * d + c] += moves ? place[half * m + c] * by_place[c] +
                                                 rate[half * m + c] * by_rate[c]
                                           : place[half * m + c] * by_place[c];
        for (Size c = 0; c <= touched; c++)
            row[knots + shared->column[c]] += by[lead + c];
    }
}

/* List the constants that a group touches, the residual's column behind them; give their number. */
INLINE Size touch(const Blocks *all, const Shared *shared, Size first, Size end)
{
    Size touched = 0;
    for (Size i = first; i < end; i++)
        for (Size m = all->first[i]; m < all->first[i + 1]; m++) {
            Size column = (Size)all->constant_column[all->entry[m]];
            if (shared->slot[column] < 0) {
                shared->slot[column] = touched;
                shared->column[touched++] = column;
            }
        }
    shared->column[touched] = all->constants;
    return touched;
}

/* Add the products of one group's rows, over the columns that it touches. Order 0: the rows are
   laid out over the knots; else their weights are. */
INLINE void add_group(Size order, int moves, const Blocks *all, const Shared *shared, Size k)
{
    Size first = (Size)shared->start[k], end = end_of(shared->groups, shared->start, k, all->n);
    Size d = all->path + all->walks, knots = all->chained ? 2 * d : d;
    Size others = all->constants + 1, full = knots + others, count = end - first;
    Size lead = order == 0 ? knots : moves ? 6 : 3, touched = touch(all, shared, first, end);
    Size last = lead + touched, pad = PADDED(last + 1);
    double *slope = shared->products, *products = shared->products;
    for (Size i = first; i < end; i++) {
        double *row = shared->rows + (i - first) * pad;
        double root = all->weight == NULL ? 1.0 : all->weight[i];
        if (order == 0)
            lay_out(all, i, 0, root, d, knots, row);
        for (Size j = 0; j < 3 && order != 0; j++) {
            row[j] = root * all->by_path[3 * i + j];
            if (moves)
                row[3 + j] = root * shared->by_velocity[3 * i + j];
        }
        for (Size j = lead; j < pad; j++)
            row[j] = 0.0;
        for (Size m = all->first[i]; m < all->first[i + 1]; m++) {
            Size entry = all->entry[m];
            row[lead + shared->slot[all->constant_column[entry]]] +=
                root * all->by_constants[entry];
        }
        row[last] = root * all->residual[i];
        if (shared->by_common != NULL)
            slope[i - first] = root * shared->by_common[i];
    }
    if (shared->by_common != NULL)
        take_up(shared, k, slope, count, last, pad);
    memset(products, 0, sizeof(double) * (size_t)(pad * pad));
    for (Size i = 0; i < count; i++) {
        const double *restrict row = shared->rows + i * pad;
        for (Size a = 0; a <= last; a++) {
            double *restrict out = products + a * pad, by = row[a];
            for (Size b = 0; b < pad; b++)
                out[b] += by * row[b];
        }
    }
    Size place = (Size)all->interval[first];
    double *total = all->knots + place * knots * full;
    if (order)
        spread_out(order, moves, all, shared, first, touched, pad, total);
    for (Size a = 0; a < knots && order == 0; a++) {
        for (Size b = 0; b < knots; b++)
            total[a * full + b] += products[a * pad + b];
        for (Size b = 0; b <= touched; b++)
            total[a * full + knots + shared->column[b]] += products[a * pad + knots + b];
    }
    total = all->others + (all->held > 1 ? place * others * others : 0);
    for (Size a = 0; a <= touched; a++) {
        for (Size b = 0; b <= touched; b++)
            total[shared->column[a] * others + shared->column[b]] +=
                products[(lead + a) * pad + lead + b];
        shared->slot[shared->column[a]] = -1;
    }
}

WIDE static void add_groups(const Blocks *all, const Shared *shared)
{
    int moves = shared->by_velocity != NULL;
    /* Loops of known length are unrolled for the usual motion. */
    for (Size k = 0; k < shared->groups; k++)
        if (all->order == 0)
            add_group(0, 0, all, shared, k);
        else if (all->order == 3)
            moves ? add_group(3, 1, all, shared, k) : add_group(3, 0, all, shared, k);
        else
            moves ? add_group(all->order, 1, all, shared, k) : add_group(all->order, 0, all, shared, k);
}

static int shared_fits(const Blocks *all, const Shared *shared)
{
    int fits = covers(shared->groups, shared->start, all->n) && (all->f == 0 || all->chained) &&
               within(all->n, all->interval, all->intervals) &&
               within(all->e, all->constant_column, all->constants) &&
               within(all->f, all->walk_column, all->walks);
    /* What shares an unknown was emitted together. */
    for (Size k = 0; fits && k < shared->groups; k++)
        for (Size i = (Size)shared->start[k]; i < end_of(shared->groups, shared->start, k, all->n);
             i++)
            fits &= all->interval[i] == all->interval[shared->start[k]];
    return fits;
}

/* Room for the products of groups, of no more rows than so many, and the index of their columns. */
static double *room_for_groups(Shared *shared, Size knots, Size others, Size largest)
{
    Size wide = PADDED((knots > 6 ? knots : 6) + others);
    Size most = wide * wide > largest ? wide * wide : largest;
    double *room = malloc(sizeof(double) * (size_t)(most + largest * wide + 2 * wide));
    shared->column = malloc(sizeof(Size) * (size_t)(2 * others));
    if (room == NULL || shared->column == NULL) {
        free(room);
        free(shared->column);
        return NULL;
    }
    shared->products = room;
    shared->rows = room + most;
    shared->taken = shared->rows + largest * wide;
    shared->by_knots = shared->taken + wide;
    shared->slot = shared->column + others;
    for (Size j = 0; j < others; j++)
        shared->slot[j] = -1;
    return room;
}

static Size largest_group(Size groups, const int64_t *start, Size n)
{
    Size largest = 0;
    for (Size k = 0; k < groups; k++) {
        Size count = end_of(groups, start, k, n) - (Size)start[k];
        largest = count > largest ? count : largest;
    }
    return largest;
}

static PyObject *add_shared(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Blocks all;
    Shared shared;
    memset(&all, 0, sizeof all);
    start(&reader, arguments, given);
    all.intervals = whole(&reader);
    all.held = whole(&reader);
    all.path = whole(&reader);
    all.walks = whole(&reader);
    all.constants = whole(&reader);
    all.chained = (int)whole(&reader);
    all.n = whole(&reader);
    all.r = 1;
    all.order = whole(&reader);
    shared.groups = whole(&reader);
    all.e = whole(&reader);
    all.f = whole(&reader);
    if (!reader.failed &&
        ((all.held != 1 && all.held != all.intervals) ||
         (all.order && (all.path != 3 * all.order || all.order > MOST_ORDER || all.f)))) {
        PyErr_SetString(PyExc_ValueError, "expected sums of one interval or of each; weights of "
                                          "1 to 3 blocks only where no walk is felt");
        reader.failed = 1;
    }
    Size d = all.path + all.walks, knots = all.chained ? 2 * d : d;
    Size others = all.constants + 1, full = knots + others;
    all.knots = results(&reader, all.intervals * knots * full);
    all.others = results(&reader, all.held * others * others);
    all.residual = reals(&reader, all.n);
    all.interval = integers(&reader, all.n);
    all.by_path = reals(&reader, all.n * (all.order ? 3 : 2 * all.path));
    all.weights = reals(&reader, all.n * 2 * all.order);
    shared.by_velocity = reals(&reader, 3 * all.n);
    shared.rates = reals(&reader, all.n * 2 * all.order);
    all.scale = reals(&reader, all.path);
    all.constant_row = integers(&reader, all.e);
    all.constant_column = integers(&reader, all.e);
    all.by_constants = reals(&reader, all.e);
    all.walk_row = integers(&reader, all.f);
    all.walk_column = integers(&reader, all.f);
    all.before = reals(&reader, all.f);
    all.after = reals(&reader, all.f);
    all.by_walks = reals(&reader, all.f);
    all.weight = reals(&reader, all.n);
    shared.start = integers(&reader, shared.groups);
    shared.by_common = reals(&reader, all.n);
    shared.information = reals(&reader, shared.groups);
    if (!complete(&reader, all.knots && all.others && all.residual && all.interval && all.by_path &&
                               all.scale && all.constant_row && all.constant_column &&
                               all.by_constants && all.walk_row && all.walk_column && all.before &&
                               all.after && all.by_walks && shared.start &&
                               (all.weights || !all.order) &&
                               (shared.rates || !shared.by_velocity) &&
                               (shared.information || !shared.by_common))) {
        release(&reader);
        return NULL;
    }
    int fits = shared_fits(&all, &shared);
    Size largest = fits ? largest_group(shared.groups, shared.start, all.n) : 0;
    double *room = room_for_groups(&shared, knots, others, largest);
    Size *index = malloc(sizeof(Size) * (size_t)(2 * (all.n + 2) + all.e + all.f));
    if (room == NULL || index == NULL) {
        if (room != NULL)
            free(shared.column);
        free(room);
        free(index);
        release(&reader);
        return PyErr_NoMemory();
    }
    Size *first_walk = index + all.n + 2, *entry = first_walk + all.n + 2;
    Size *entry_walk = entry + all.e;
    all.first = index;
    all.first_walk = first_walk;
    all.entry = entry;
    all.entry_walk = entry_walk;
    Py_BEGIN_ALLOW_THREADS
    fits = fits && by_row(all.n, all.e, all.constant_row, index, entry) &&
           by_row(all.n, all.f, all.walk_row, first_walk, entry_walk);
    if (fits)
        add_groups(&all, &shared);
    Py_END_ALLOW_THREADS
    free(shared.column);
    free(room);
    free(index);
    release(&reader);
    if (!fits) {
        PyErr_SetString(PyExc_IndexError, "a group, interval, row or column is out of range");
        return NULL;
    }
    Py_RETURN_NONE;
}

/* Evaluate, settle and add up a family at once, where no loss asks for weights; returns its cost.
   What lies between is kept here and dropped. */
static double sums_of(Radio *all, Blocks *sums, Shared *shared, const double *weight, double *room)
{
    Size n = all->n, width = all->way.width, g = all->g;
    int rates = all->kind == FREQUENCY_DIFFERENCES;
    double *value = room + n, *root = value + g, *changed = root + n;
    double cost = 0.0;
    int added = sums->knots != NULL;
    all->residual = room;
    all->by_position = changed + n;
    all->by_place = all->by_position + 3 * n;
    all->by_velocity = rates ? all->by_place + width * n : NULL;
    all->by_rate = rates ? all->by_velocity + 3 * n : NULL;
    double *next = rates ? all->by_rate + width * n : all->by_place + width * n;
    if (all->kind == ARRIVALS) {
        shared->by_common = all->by_common = next;
        next += n;
    }
    all->by_constants = next;
    all->interval = (int64_t *)(next + all->entries);
    if (!added)
        all->by_position = all->by_constants = NULL;
    radio_all(all);
    sums->residual = all->residual;
    if (shared->by_common != NULL) {
        settle_all(g, all->start, n, all->residual, shared->by_common, weight,
                   shared->information, NULL, value, changed);
        sums->residual = changed;
        for (Size k = 0; k < g && shared->information != NULL; k++)
            cost += shared->information[k] * value[k] * value[k];
    }
    for (Size i = 0; i < n; i++) {
        double square = sums->residual[i] * sums->residual[i];
        cost += weight == NULL ? square : weight[i] * square;
        root[i] = weight == NULL ? 1.0 : sqrt(weight[i]);
    }
    sums->interval = all->interval;
    sums->by_path = all->by_position;
    sums->weights = all->by_place;
    sums->by_constants = all->by_constants;
    sums->weight = weight == NULL ? NULL : root;
    shared->by_velocity = all->by_velocity;
    shared->rates = all->by_rate;
    if (added && isfinite(cost))
        add_groups(sums, shared);
    return 0.5 * cost;
}

static PyObject *radio_sums(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Radio all;
    Blocks sums;
    Shared shared;
    memset(&sums, 0, sizeof sums);
    memset(&shared, 0, sizeof shared);
    start(&reader, arguments, given);
    const Plan *plan = planned(&reader, &all);
    int there = read_point(&reader, &all);
    Size n = all.n;
    const double *weight = reals(&reader, n);
    shared.by_common = reals(&reader, n);
    shared.information = reals(&reader, all.g);
    sums.walks = whole(&reader);
    sums.constants = all.constants;
    sums.order = all.way.order;
    sums.path = 3 * sums.order;
    sums.chained = all.way.knots > 1;
    sums.intervals = sums.chained ? all.way.knots - 1 : 1;
    sums.held = 1;
    Size d = sums.path + sums.walks, knots = sums.chained ? 2 * d : d;
    Size others = sums.constants + 1;
    sums.scale = reals(&reader, sums.path);
    sums.knots = results(&reader, sums.intervals * knots * (knots + others));
    sums.others = results(&reader, others * others);
    if (!reader.failed && sums.order == 0) {
        PyErr_SetString(PyExc_ValueError, "expected weights of 1 to 3 blocks");
        reader.failed = 1;
    }
    if (!complete(&reader, there && sums.scale && (sums.others || !sums.knots)) ||
        !room_for_errors(&all)) {
        release(&reader);
        return NULL;
    }
    sums.n = n;
    sums.r = 1;
    sums.e = all.entries;
    sums.constant_column = plan->column;
    sums.first = plan->first;
    sums.entry = plan->entry;
    shared.groups = all.g;
    shared.start = all.start;
    double *room = malloc(sizeof(double) *
                          (size_t)(n * (11 + 2 * all.way.width) + all.g + all.entries + 1));
    double *groups = room_for_groups(&shared, knots, others, largest_group(all.g, all.start, n));
    double cost = 0.0;
    if (room != NULL && groups != NULL) {
        Py_BEGIN_ALLOW_THREADS
        cost = sums_of(&all, &sums, &shared, weight, room);
        Py_END_ALLOW_THREADS
    }
    int made = room != NULL && groups != NULL;
    if (groups != NULL)
        free(shared.column);
    free(groups);
    free(room);
    free(all.errors[0]);
    release(&reader);
    return made ? PyFloat_FromDouble(cost) : PyErr_NoMemory();
}
