// A C interface to what the law needs of DAIDALUS: the resolution nearest to a wanted velocity.

#include <cmath>
#include <string>

#include "CDCylinder.h"
#include "Daidalus.h"

using namespace larcfm;

extern "C" {

// One aircraft's DAIDALUS: a cylinder to keep clear of (its radius and half its height, m), and a greatest speed (m/s).
void* dmuca_daidalus_new(double radius_m, double height_m, double lookahead_s, double speed_mps) {
  Daidalus* daa = new Daidalus();
  CDCylinder cylinder(radius_m, "m", height_m, "m");
  Alerter alerter("dmuca");
  alerter.addLevel(AlertThresholds(cylinder, lookahead_s, lookahead_s, BandsRegion::NEAR));
  daa->clearAlerters();
  daa->addAlerter(alerter);
  daa->setCorrectiveRegion(BandsRegion::NEAR);
  daa->setLookaheadTime(lookahead_s, "s");
  daa->setMinHorizontalSpeed(0.0, "m/s");
  daa->setMaxHorizontalSpeed(speed_mps, "m/s");
  daa->setHorizontalSpeedStep(0.25, "m/s");
  daa->setHorizontalDirectionStep(2.0, "deg");
  daa->setTurnRate(45.0, "deg/s");
  daa->setHorizontalAcceleration(2.0, "m/s^2");
  daa->setMinHorizontalRecovery(0.5 * radius_m, "m");
  daa->setMinVerticalRecovery(0.5 * height_m, "m");
  daa->setRecoveryHorizontalDirectionBands(true);
  daa->setRecoveryHorizontalSpeedBands(true);
  daa->setCollisionAvoidanceBands(true);
  daa->setHysteresisTime(0.0, "s");
  daa->setPersistenceTime(0.0, "s");
  daa->setAlertingMofN(0, 0);
  return daa;
}

void dmuca_daidalus_delete(void* daa) { delete static_cast<Daidalus*>(daa); }

// The velocity to fly. Places and velocities are NED: three numbers of each, of others one after the other.
// Returns 0: the wanted velocity is in no conflict band; 1: `found` is the nearest resolution in direction, or in
// speed where there is none in direction; 2: there is none.
int dmuca_daidalus_decide(void* pointer, double now_s, const double* own, const double* wanted, int count,
                          const double* places, const double* velocities, double* found) {
  Daidalus& daa = *static_cast<Daidalus*>(pointer);
  daa.setOwnshipState("own", Position::makeXYZ(own[1], "m", own[0], "m", -own[2], "m"),
                      Velocity::makeVxyz(wanted[1], wanted[0], "m/s", -wanted[2], "m/s"), now_s);
  for (int i = 0; i < count; i++) {
    const double* p = places + 3 * i;
    const double* v = velocities + 3 * i;
    daa.addTrafficState(std::to_string(i), Position::makeXYZ(p[1], "m", p[0], "m", -p[2], "m"),
                        Velocity::makeVxyz(v[1], v[0], "m/s", -v[2], "m/s"), now_s);
  }
  for (int i = 0; i < 3; i++) found[i] = wanted[i];
  const double speed = std::hypot(wanted[0], wanted[1]), course = std::atan2(wanted[1], wanted[0]);
  if (BandsRegion::isResolutionBand(daa.regionOfHorizontalDirection(course, "rad"))) return 0;
  // A direction if there is one: aircraft that slow down for each other would wait for ever.
  double nearest = INFINITY;
  for (int what = 0; what < 2 && !std::isfinite(nearest); what++) {
    for (int side = 0; side < 2; side++) {
      const double advice = what == 0 ? daa.horizontalDirectionResolution(side == 0, "rad")
                                      : daa.horizontalSpeedResolution(side == 0, "m/s");
      if (!std::isfinite(advice)) continue;
      const double n = what == 0 ? speed * std::cos(advice) : advice * std::cos(course);
      const double e = what == 0 ? speed * std::sin(advice) : advice * std::sin(course);
      const double away = std::hypot(n - wanted[0], e - wanted[1]);
      if (away < nearest) {
        nearest = away;
        found[0] = n;
        found[1] = e;
      }
    }
  }
  return std::isfinite(nearest) ? 1 : 2;
}
}
