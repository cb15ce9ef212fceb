// A C interface to what the law needs of DAIDALUS: the resolution nearest to a wanted velocity.

#include <cmath>
#include <map>
#include <memory>
#include <string>
#include <tuple>

#include "CDCylinder.h"
#include "Daidalus.h"

using namespace larcfm;

namespace {

struct Question {
  Daidalus daa;
  double radius_m = 0.0, lookahead_s = 0.0, speed_mps = 0.0;
  double n = 0.0, e = 0.0;          // the own place
  double vn = 0.0, ve = 0.0;        // the wanted velocity
  double north = 0.0, east = 0.0;  // the answer
};

void set_up(Daidalus& daa, double radius_m, double lookahead_s, double speed_mps, double collision_m) {
  CDCylinder cylinder(radius_m, "m", radius_m, "m");
  Alerter alerter("dmuca");
  alerter.addLevel(AlertThresholds(cylinder, lookahead_s, lookahead_s, BandsRegion::NEAR));
  daa.clearAlerters();
  daa.addAlerter(alerter);
  daa.setCorrectiveRegion(BandsRegion::NEAR);
  daa.setLookaheadTime(lookahead_s, "s");
  daa.setMinAirSpeed(0.0, "m/s");  // otherwise directions are judged as if flown at 10 kt
  daa.setMinHorizontalSpeed(0.0, "m/s");
  daa.setMaxHorizontalSpeed(speed_mps, "m/s");
  daa.setHorizontalSpeedStep(0.25, "m/s");
  daa.setHorizontalDirectionStep(2.0, "deg");
  daa.setTurnRate(45.0, "deg/s");
  daa.setHorizontalAcceleration(2.0, "m/s^2");
  daa.setHorizontalNMAC(collision_m, "m");
  daa.setVerticalNMAC(collision_m, "m");
  daa.setMinHorizontalRecovery(radius_m, "m");
  daa.setMinVerticalRecovery(radius_m, "m");
  daa.setRecoveryHorizontalDirectionBands(true);
  daa.setRecoveryHorizontalSpeedBands(true);
  daa.setCollisionAvoidanceBands(true);
  daa.setHysteresisTime(0.0, "s");
  daa.setPersistenceTime(0.0, "s");
  daa.setAlertingMofN(0, 0);
}

}  // namespace

#pragma GCC visibility push(default)
extern "C" {

// A DAIDALUS with a cylinder to keep clear of (its radius and half height), a horizon and a greatest speed. A recovery
// from inside the cylinder leaves it again if it can, else it keeps less, down to `collision_m`, the distance at which
// aircraft collide. If that cannot be kept either, DAIDALUS advises no recovery. It remembers nothing from one question
// to the next, so that all aircraft of a thread share one.
void* dmuca_daidalus_set_up(double radius_m, double lookahead_s, double speed_mps, double collision_m) {
  thread_local std::map<std::tuple<double, double, double, double>, std::unique_ptr<Question>> all;
  auto& question = all[{radius_m, lookahead_s, speed_mps, collision_m}];
  if (!question) {
    question = std::make_unique<Question>();
    question->radius_m = radius_m;
    question->lookahead_s = lookahead_s;
    question->speed_mps = speed_mps;
    set_up(question->daa, radius_m, lookahead_s, speed_mps, collision_m);
  }
  return question.get();
}

// Begins a question: the own place and the wanted velocity, NED.
void dmuca_daidalus_begin(void* pointer, double n, double e, double d, double vn, double ve, double vd) {
  Question& question = *static_cast<Question*>(pointer);
  question.n = n;
  question.e = e;
  question.vn = question.north = vn;
  question.ve = question.east = ve;
  question.daa.clear();
  question.daa.setOwnshipState("own", Position::makeXYZ(e, "m", n, "m", -d, "m"),
                               Velocity::makeVxyz(ve, vn, "m/s", -vd, "m/s"), 0.0);
}

// Adds another aircraft to a question, unless no change of course or speed could bring it into the volume before the
// horizon (with a metre to spare). It would then change no answer.
void dmuca_daidalus_add(void* pointer, double n, double e, double d, double vn, double ve, double vd) {
  Question& question = *static_cast<Question*>(pointer);
  const double own_mps = std::fmax(question.speed_mps, std::hypot(question.vn, question.ve));
  const double closing = std::hypot(vn, ve) + own_mps;
  if (std::hypot(n - question.n, e - question.e) > question.radius_m + question.lookahead_s * closing + 1.0) return;
  Daidalus& daa = question.daa;
  daa.addTrafficState(std::to_string(daa.lastTrafficIndex()), Position::makeXYZ(e, "m", n, "m", -d, "m"),
                      Velocity::makeVxyz(ve, vn, "m/s", -vd, "m/s"), 0.0);
}

// Answers a question. `directions_first`: a change of speed counts only where there is no direction; otherwise the
// nearer of both counts. Returns 0: the wanted velocity is in no conflict band; 1: `dmuca_daidalus_north` and `_east`
// are the nearest resolution; 2: there is none.
int dmuca_daidalus_decide(void* pointer, int directions_first) {
  Question& question = *static_cast<Question*>(pointer);
  Daidalus& daa = question.daa;
  const double speed = std::hypot(question.vn, question.ve), course = std::atan2(question.ve, question.vn);
  if (BandsRegion::isResolutionBand(daa.regionOfHorizontalDirection(course, "rad"))) return 0;
  double nearest = INFINITY;
  for (int what = 0; what < 2 && !(directions_first && std::isfinite(nearest)); what++) {
    for (int side = 0; side < 2; side++) {
      const double advice = what == 0 ? daa.horizontalDirectionResolution(side == 0, "rad")
                                      : daa.horizontalSpeedResolution(side == 0, "m/s");
      if (!std::isfinite(advice)) continue;
      const double n = what == 0 ? speed * std::cos(advice) : advice * std::cos(course);
      const double e = what == 0 ? speed * std::sin(advice) : advice * std::sin(course);
      const double away = std::hypot(n - question.vn, e - question.ve);
      if (away < nearest) {
        nearest = away;
        question.north = n;
        question.east = e;
      }
    }
  }
  return std::isfinite(nearest) ? 1 : 2;
}

double dmuca_daidalus_north(void* pointer) { return static_cast<Question*>(pointer)->north; }
double dmuca_daidalus_east(void* pointer) { return static_cast<Question*>(pointer)->east; }
}
