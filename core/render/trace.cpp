// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/trace.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <new>
#include <string>
#include <type_traits>

#include "core/base/check.h"
#include "core/base/elementary.h"

namespace spherule {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

struct DeviceDeleter {
  void operator()(RTCDevice device) const { rtcReleaseDevice(device); }
};
struct SceneDeleter {
  void operator()(RTCScene scene) const { rtcReleaseScene(scene); }
};
using Device = std::unique_ptr<std::remove_pointer_t<RTCDevice>, DeviceDeleter>;
using Scene = std::unique_ptr<std::remove_pointer_t<RTCScene>, SceneDeleter>;

// Which lanes Embree looks at: -1, or 0.
struct Switches {
  alignas(64) std::array<int, Lanes::most> valid{};
};

// Embree hands its context back to the callbacks; what follows it in memory is ours.
struct Query {
  RTCIntersectContext context;
  Lanes* lanes;
  std::array<double, Lanes::most> skipped;  // mm of each ray that Embree does not see
};

// The smallest float that is not below it, or a little more.
float not_less(double distance) { return static_cast<float>(distance) * (1 + 0x1p-22F) + 0x1p-126F; }

// Of a ball with no radius, all that Embree sees is its centre; the same for what is too small to be scaled.
constexpr double kLeastRadius = 0x1p-960;
// In Embree's numbers: beyond any place in the scene, from any place at its edge.
constexpr double kBeyond = 8;

}  // namespace

// Embree's numbers are relative to the scene's centre, in about the scene's radius (a power of two, so that nothing is
// rounded): there single precision is finest, and no square of a length can be too large or too small for it.
struct Hierarchy::State {
  const Primitives& primitives;
  Vec3 centre;
  double radius = 0;  // mm, of a ball that holds all boxes
  double scale = 1;   // from mm; makes `radius` a half to 1
  double slack = 0;   // mm by which boxes grow: more than single precision can lose on a ray's way through the scene
  Device device;
  Scene scene;

  static void bounds(const RTCBoundsFunctionArguments* arguments) {
    const auto& state = *static_cast<const State*>(arguments->geometryUserPtr);
    const Box box = state.primitives.box(arguments->primID);
    const Vec3 grow{state.slack, state.slack, state.slack};
    const Vec3 min = state.scale * (box.min - state.centre - grow), max = state.scale * (box.max - state.centre + grow);
    *arguments->bounds_o = {static_cast<float>(min.x), static_cast<float>(min.y), static_cast<float>(min.z), 0,
                            static_cast<float>(max.x), static_cast<float>(max.y), static_cast<float>(max.z), 0};
  }

  // Lets the primitive meet the valid rays; calls met(query, k, lane) for the rays that it stops. Embree shows as many
  // rays at a time as suit the processor, whatever it was given: each knows its lane as its id.
  template <typename Arguments, typename Met>
  static void meet(const Arguments& arguments, RTCRayN* rays, Met met) {
    auto& query = *reinterpret_cast<Query*>(arguments.context);
    const auto& state = *static_cast<const State*>(arguments.geometryUserPtr);
    alignas(64) std::array<int, Lanes::most> valid{};
    std::array<unsigned, Lanes::most> shown;
    std::size_t begin = Lanes::most, end = 0;
    for (unsigned k = 0; k < arguments.N; ++k) {
      if (arguments.valid[k] == 0) continue;
      const std::size_t lane = RTCRayN_id(rays, arguments.N, k);
      valid[lane] = -1, shown[lane] = k;
      begin = std::min(begin, lane), end = std::max(end, lane + 1);
    }
    std::uint32_t lanes = state.primitives.meet(arguments.primID, *query.lanes, valid.data(), begin, end);
    for (; lanes != 0; lanes &= lanes - 1) {
      const auto lane = static_cast<std::size_t>(std::countr_zero(lanes));
      met(query, shown[lane], lane);
    }
  }

  static void intersect(const RTCIntersectFunctionNArguments* arguments) {
    RTCRayN* rays = RTCRayHitN_RayN(arguments->rayhit, arguments->N);
    RTCHitN* hits = RTCRayHitN_HitN(arguments->rayhit, arguments->N);
    const auto& state = *static_cast<const State*>(arguments->geometryUserPtr);
    meet(*arguments, rays, [&](const Query& query, unsigned k, std::size_t lane) {
      RTCRayN_tfar(rays, arguments->N, k) = not_less(state.scale * (query.lanes->far[lane] - query.skipped[lane]));
      RTCHitN_geomID(hits, arguments->N, k) = arguments->geomID;
      RTCHitN_primID(hits, arguments->N, k) = arguments->primID;
    });
  }
  static void occluded(const RTCOccludedFunctionNArguments* arguments) {
    meet(*arguments, arguments->ray,
         [&](const Query&, unsigned k, std::size_t) { RTCRayN_tfar(arguments->ray, arguments->N, k) = -kInfinity; });
  }

  static bool keep_building(void* context, double) {
    return !static_cast<const Context*>(context)->cancel.stop_requested();
  }

  // Puts the first `count` rays into Embree's numbers, and says which of them come near the scene: no other is shown to
  // Embree. So every coordinate is at most 3, whatever the rays are. Rays from afar start at the scene's edge.
  Switches prepare(std::size_t count, Query& query, RTCRay16& rays) const {
    const Lanes& l = *query.lanes;
    const double edge = 1.01 * radius;
    Switches on;
    for (std::size_t i = 0; i < Lanes::most; ++i) {
      const double x = l.ox[i] - centre.x, y = l.oy[i] - centre.y, z = l.oz[i] - centre.z;
      const double along = x * l.dx[i] + y * l.dy[i] + z * l.dz[i], nearing = -along - edge;
      const double skip = nearing > 0 ? nearing : 0, now = along + skip;
      const double ax = x - along * l.dx[i], ay = y - along * l.dy[i], az = z - along * l.dz[i];
      const bool near = ax * ax + ay * ay + az * az <= edge * edge && now <= edge && l.far[i] >= skip;
      query.skipped[i] = skip;
      on.valid[i] = near && i < count ? -1 : 0;
      // Some of Embree's ways through the scene go by the mask, others by rays that end before they start.
      rays.org_x[i] = near ? static_cast<float>(scale * (ax + now * l.dx[i])) : 0;
      rays.org_y[i] = near ? static_cast<float>(scale * (ay + now * l.dy[i])) : 0;
      rays.org_z[i] = near ? static_cast<float>(scale * (az + now * l.dz[i])) : 0;
      rays.dir_x[i] = near ? static_cast<float>(l.dx[i]) : 1;
      rays.dir_y[i] = near ? static_cast<float>(l.dy[i]) : 0;
      rays.dir_z[i] = near ? static_cast<float>(l.dz[i]) : 0;
      rays.tfar[i] = on.valid[i] != 0 ? not_less(std::min(kBeyond, scale * (l.far[i] - skip))) : -1;
      rays.tnear[i] = rays.time[i] = 0;
      rays.mask[i] = ~0U;
      rays.id[i] = static_cast<unsigned>(i);
      rays.flags[i] = 0;
    }
    return on;
  }
};

Hierarchy::Hierarchy(const Primitives& primitives, const Context& context)
    : state_(std::make_unique<State>(State{primitives, {}, 0, 1, 0, nullptr, nullptr})) {
  State& s = *state_;
  const std::size_t count = primitives.size();
  SPHERULE_CHECK(count < std::numeric_limits<std::uint32_t>::max());
  Box all;
  for (std::size_t i = 0; i < count; ++i) {
    if (i % 1024 == 0) context.throw_if_cancelled();
    const Box box = primitives.box(i);
    all.include(box.min), all.include(box.max);
  }
  if (count > 0) {
    s.centre = 0.5 * (all.min + all.max);
    const Vec3 extent = all.max - all.min;
    s.radius = 0.5 * elementary::hypot(elementary::hypot(extent.x, extent.y), extent.z);
    SPHERULE_CHECK(std::isfinite(s.radius));  // render() refuses what is larger
    if (s.radius > kLeastRadius) s.scale = std::ldexp(1.0, -std::ilogb(s.radius) - 1);
    s.slack = 2e-6 * std::max({extent.x, extent.y, extent.z});
  }
  s.device.reset(rtcNewDevice(("threads=" + std::to_string(std::max(1U, context.threads))).c_str()));
  if (!s.device) throw std::bad_alloc();
  s.scene.reset(rtcNewScene(s.device.get()));
  RTCGeometry geometry = rtcNewGeometry(s.device.get(), RTC_GEOMETRY_TYPE_USER);
  rtcSetGeometryUserPrimitiveCount(geometry, static_cast<unsigned>(count));
  rtcSetGeometryUserData(geometry, &s);
  rtcSetGeometryBoundsFunction(geometry, &State::bounds, nullptr);
  rtcSetGeometryIntersectFunction(geometry, &State::intersect);
  rtcSetGeometryOccludedFunction(geometry, &State::occluded);
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(s.scene.get(), geometry);
  rtcReleaseGeometry(geometry);
  rtcSetSceneProgressMonitorFunction(s.scene.get(), &State::keep_building, const_cast<Context*>(&context));
  rtcCommitScene(s.scene.get());
  rtcSetSceneProgressMonitorFunction(s.scene.get(), nullptr, nullptr);
  context.throw_if_cancelled();
  const RTCError error = rtcGetDeviceError(s.device.get());
  if (error == RTC_ERROR_OUT_OF_MEMORY) throw std::bad_alloc();
  SPHERULE_CHECK(error == RTC_ERROR_NONE);
}

Hierarchy::~Hierarchy() = default;

namespace {

RTCRay alone(const RTCRay16& rays, std::size_t lane) {
  RTCRay ray{};
  ray.org_x = rays.org_x[lane], ray.org_y = rays.org_y[lane], ray.org_z = rays.org_z[lane];
  ray.dir_x = rays.dir_x[lane], ray.dir_y = rays.dir_y[lane], ray.dir_z = rays.dir_z[lane];
  ray.tfar = rays.tfar[lane];
  ray.mask = ~0U;
  ray.id = static_cast<unsigned>(lane);
  return ray;
}

}  // namespace

void Hierarchy::nearest(Lanes& lanes, std::size_t count, bool alike) const {
  Query query;
  rtcInitIntersectContext(&query.context);
  query.lanes = &lanes;
  RTCRayHit16 packet;
  const Switches on = state_->prepare(count, query, packet.ray);
  if (alike && count > 1) {
    query.context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    std::fill_n(packet.hit.geomID, Lanes::most, RTC_INVALID_GEOMETRY_ID);
    rtcIntersect16(on.valid.data(), state_->scene.get(), &query.context, &packet);
    return;
  }
  for (std::size_t lane = 0; lane < count; ++lane) {
    if (on.valid[lane] == 0) continue;
    RTCRayHit hit{};
    hit.ray = alone(packet.ray, lane);
    hit.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(state_->scene.get(), &query.context, &hit);
  }
}

void Hierarchy::any(Lanes& lanes, std::size_t count, bool alike) const {
  Query query;
  rtcInitIntersectContext(&query.context);
  query.lanes = &lanes;
  RTCRay16 packet;
  const Switches on = state_->prepare(count, query, packet);
  if (alike && count > 1) {
    query.context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    rtcOccluded16(on.valid.data(), state_->scene.get(), &query.context, &packet);
    return;
  }
  for (std::size_t lane = 0; lane < count; ++lane) {
    if (on.valid[lane] == 0) continue;
    RTCRay ray = alone(packet, lane);
    rtcOccluded1(state_->scene.get(), &query.context, &ray);
  }
}

void Hierarchy::first_hits(std::span<const Ray> rays, std::span<Hit> hits) const {
  Lanes lanes;
  for (std::size_t begin = 0; begin < rays.size(); begin += Lanes::most) {
    const std::size_t count = lanes.load(rays.subspan(begin));
    nearest(lanes, count, true);
    for (std::size_t i = 0; i < count; ++i) hits[begin + i] = {lanes.far[i], lanes.primitive[i], {}};
  }
}

void Hierarchy::blocked(std::span<const Ray> rays, std::span<std::uint8_t> blocked, bool alike) const {
  Lanes lanes;
  for (std::size_t begin = 0; begin < rays.size(); begin += Lanes::most) {
    const std::size_t count = lanes.load(rays.subspan(begin));
    any(lanes, count, alike);
    for (std::size_t i = 0; i < count; ++i) blocked[begin + i] = lanes.primitive[i] != no_primitive;
  }
}

std::size_t Lanes::load(std::span<const Ray> rays) {
  const std::size_t count = std::min(most, rays.size());
  for (std::size_t i = 0; i < most; ++i) {
    const Ray& ray = rays[std::min(i, count - 1)];
    ox[i] = ray.origin.x, oy[i] = ray.origin.y, oz[i] = ray.origin.z;
    dx[i] = ray.direction.x, dy[i] = ray.direction.y, dz[i] = ray.direction.z;
    far[i] = ray.far;
    primitive[i] = no_primitive;
  }
  return count;
}

std::optional<Hit> Tracer::first_hit(const Ray& ray) const {
  Hit hit;
  first_hits(std::span(&ray, 1), std::span(&hit, 1));
  return hit ? std::optional(hit) : std::nullopt;
}

bool Tracer::blocked(const Ray& ray) const {
  std::uint8_t is = 0;
  blocked(std::span(&ray, 1), std::span(&is, 1), false);
  return is != 0;
}

}  // namespace spherule
