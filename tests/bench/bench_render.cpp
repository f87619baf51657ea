// SPDX-License-Identifier: GPL-3.0-or-later
//
// Pictures of 64, of 10,000 and of all spheres of a head: rays a second with shadows and sky, and memory. Then the same
// spheres and a blob, with the key light's shadows only, by Tachyon and by POV-Ray from the same camera, on the same
// number of threads; the share of pixels in which only one of two programs sees the object says whether they draw the
// same thing. Of the peers only the time that they state for tracing is counted, without reading the scene; of ours the
// whole picture, from the list of spheres on. Processor time is that of the whole programs.
//
// Antialiasing: 3 × 3 sight lines a pixel, of Tachyon everywhere, of POV-Ray and ours where neighbours differ by 0.1
// (ours by what is left of an even change, see scene.cpp). Shadows: the peers have one hard shadow ray a sight line,
// ours one ray a pixel to a lamp with a size, smoothed over its neighbours on the surface.
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include "core/pipeline.h"
#include "core/render/render.h"
#include "core/render/scene.h"
#include "core/simplify/splitting.h"
#include "tests/bench/scans.h"

using namespace spherule;

namespace {

constexpr unsigned kThreads = 2;
const Context kContext{.threads = kThreads, .cancel = {}, .progress = {}};

// Counts the rays that a tracer is asked for.
class Counted final : public Tracer {
 public:
  Counted(std::unique_ptr<const Tracer> tracer, std::atomic<std::uint64_t>& rays)
      : tracer_(std::move(tracer)), rays_(rays) {}
  Box bounds() const override { return tracer_->bounds(); }
  void first_hits(std::span<const Ray> rays, std::span<Hit> hits) const override {
    rays_ += rays.size();
    tracer_->first_hits(rays, hits);
  }
  void blocked(std::span<const Ray> rays, std::span<std::uint8_t> blocked, bool alike) const override {
    rays_ += rays.size();
    tracer_->blocked(rays, blocked, alike);
  }
  bool inside(Vec3 point) const override { return tracer_->inside(point); }
  Place place(const Ray& ray, const Hit& hit) const override { return tracer_->place(ray, hit); }
  Colour colour(Vec3 point, const Hit& hit, std::span<const Colour> table) const override {
    return tracer_->colour(point, hit, table);
  }
  double curvature(Vec3 point, const Hit& hit) const override { return tracer_->curvature(point, hit); }
  std::vector<double> typical_curvatures() const override { return tracer_->typical_curvatures(); }

 private:
  std::unique_ptr<const Tracer> tracer_;
  std::atomic<std::uint64_t>& rays_;
};

double resident_mib() {
  std::ifstream statm("/proc/self/statm");
  double all = 0, resident = 0;
  statm >> all >> resident;
  return resident * static_cast<double>(::sysconf(_SC_PAGESIZE)) / 1048576;
}

Box box_of(const SphereModel& model) {
  Box box;
  for (const Sphere& s : model.spheres) box.include(s);
  return box;
}

// Rays a second of one picture as users get it.
double rays_per_second(const SphereModel& model, int runs) {
  constexpr int kWidth = 1920, kHeight = 1080;
  const double before = resident_mib();
  std::atomic<std::uint64_t> rays = 0;
  Scene scene;
  std::vector<Patch> patches;
  const double preparing = bench::seconds([&] {
    patches = visible_patches(model, kContext);
    Body body;
    body.tracer = std::make_unique<Counted>(trace_balls(model.spheres, patches, {}, kContext), rays);
    body.material = {0.9, 0.7, 0.5};
    scene.bodies.push_back(std::move(body));
  });
  const double scene_mib = resident_mib() - before;
  const Camera camera = make_camera({}, View::anterior, 0, box_of(model), kWidth, kHeight);
  std::vector<double> times;
  for (int run = 0; run < runs; ++run) {
    rays = 0;
    times.push_back(bench::seconds([&] {
      shoot(scene, camera, {kWidth, kHeight, 3, Background::white}, "render", kContext);
    }));
  }
  const double time = bench::median(times), rate = static_cast<double>(rays) / time;
  std::printf("%9zu spheres  %8zu patches  prepared in %6.3f s, %6.0f MiB   %4.1f Mrays in %6.3f s: %5.2f Mrays/s\n",
              model.spheres.size(), patches.size(), preparing, scene_mib, static_cast<double>(rays) / 1e6, time,
              rate / 1e6);
  std::fflush(stdout);
  return rate;
}

struct Shot {
  int width, height, samples;
  Camera camera;
};

RenderOptions options_of(const Shot& shot, Style style) {
  RenderOptions options;
  options.width = shot.width, options.height = shot.height;
  options.samples_per_axis = shot.samples;
  options.background = Background::transparent;
  options.style = style;
  options.smoothness = style == Style::blobs ? 1 : 0.5;
  options.ambient_occlusion = false;
  return options;
}

std::string text(Vec3 v) {
  char line[128];
  std::snprintf(line, sizeof line, "%.9g %.9g %.9g", v.x, v.y, v.z);
  return line;
}
std::string pov_text(Vec3 v) {
  char line[128];
  std::snprintf(line, sizeof line, "<%.9g,%.9g,%.9g>", v.x, v.y, v.z);
  return line;
}

// Where light travels to: the key light's direction of scene.h, without its size.
Vec3 light_direction(const Camera& c) { return normalised(0.60 * c.right - 0.70 * c.up + 0.62 * c.forward); }

// A folder for scenes and pictures, gone at the end.
struct Scratch {
  std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("spherule-bench-" + std::to_string(::getpid()));
  Scratch() { std::filesystem::create_directories(folder); }
  ~Scratch() { std::filesystem::remove_all(folder); }
};

std::string output_of(const std::string& command) {
  std::string out;
  if (FILE* pipe = ::popen((command + " 2>&1").c_str(), "r")) {
    char part[4096];
    while (std::fgets(part, sizeof part, pipe) != nullptr) out += part;
    ::pclose(pipe);
  }
  return out;
}

// Binary PPM, brighter than black: where the object is.
std::vector<std::uint8_t> lit(const std::filesystem::path& file, std::size_t pixels) {
  std::ifstream in(file, std::ios::binary);
  for (int word = 0; word < 4;) {  // P6, width, height, most; comments between
    std::string skipped;
    if ((in >> std::ws).peek() == '#') {
      std::getline(in, skipped);
    } else if (++word; !(in >> skipped)) {
      break;
    }
  }
  in.get();
  std::vector<char> rgb(3 * pixels);
  in.read(rgb.data(), static_cast<std::streamsize>(rgb.size()));
  std::vector<std::uint8_t> seen(pixels);
  for (std::size_t p = 0; p < pixels; ++p) seen[p] = rgb[3 * p] != 0 || rgb[3 * p + 1] != 0 || rgb[3 * p + 2] != 0;
  return seen;
}

// Percent of pixels that one program sees the object in and the other does not.
double disagreement(const Image& ours, const std::vector<std::uint8_t>& theirs) {
  std::size_t differ = 0;
  for (std::size_t p = 0; p < theirs.size(); ++p) differ += (ours.rgba[4 * p + 3] > 0) != (theirs[p] != 0);
  return 100.0 * static_cast<double>(differ) / static_cast<double>(theirs.size());
}

// Of this program, or of those that it ran.
double processor_seconds(int who) {
  rusage usage{};
  ::getrusage(who, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec) + 1e-6 * static_cast<double>(usage.ru_utime.tv_usec);
}

struct Peer {
  double seconds = 0;  // as it states for tracing alone
  std::vector<std::uint8_t> seen;
};

Peer tachyon(const SphereModel& model, const Shot& shot, const std::filesystem::path& folder) {
  const Camera& c = shot.camera;
  const auto scene = folder / "scene.dat", picture = folder / "tachyon.ppm";
  std::ofstream out(scene);
  // In the camera's own axes, right, up and forward: Tachyon's are left-handed, as these three are; the patient's are
  // not, and would come out mirrored. Orthographic: 1 / ZOOM is the height of what is seen. Tachyon looks through the
  // upper right corner of each pixel, we through its middle.
  const auto in_view = [&](Vec3 v) { return Vec3{dot(c.right, v), dot(c.up, v), dot(c.forward, v)}; };
  out << "BEGIN_SCENE\nRESOLUTION " << shot.width << ' ' << shot.height << "\nCAMERA\nPROJECTION ORTHOGRAPHIC\nZOOM "
      << 1 / (c.mm_per_pixel * shot.height) << "\nASPECTRATIO 1\nANTIALIASING 0\nRAYDEPTH 1\nCENTER "
      << text(in_view(c.centre - c.distance * c.forward - 0.5 * c.mm_per_pixel * (c.right + c.up)))
      << "\nVIEWDIR 0 0 1\nUPDIR 0 1 0\nEND_CAMERA\nDIRECTIONAL_LIGHT DIRECTION " << text(in_view(light_direction(c)))
      << " COLOR 1 1 1\nBACKGROUND 0 0 0\n"
      << "TEXDEF m AMBIENT 0.2 DIFFUSE 0.8 SPECULAR 0 OPACITY 1 COLOR 0.9 0.7 0.5 TEXFUNC 0\n";
  for (const Sphere& s : model.spheres)
    if (s.radius > 0) out << "SPHERE CENTER " << text(in_view(s.centre)) << " RAD " << s.radius << " m\n";
  out << "END_SCENE\n";
  out.close();
  const std::string log =
      output_of("timeout 30 tachyon '" + scene.string() + "' -numthreads " + std::to_string(kThreads) + " -aasamples " +
                std::to_string(shot.samples * shot.samples - 1) + " -format PPM -o '" + picture.string() + "'");
  Peer peer;
  if (const auto at = log.find("Ray Tracing Time:"); at != log.npos) peer.seconds = std::atof(log.c_str() + at + 17);
  if (peer.seconds > 0)
    peer.seen = lit(picture, static_cast<std::size_t>(shot.width) * static_cast<std::size_t>(shot.height));
  return peer;
}

// POV-Ray's field of a component is strength · (1 - d²/R²)², so ours (blobs.cpp) is the same with these strengths.
Peer pov_ray(const SphereModel& model, double blend, const Shot& shot, const std::filesystem::path& folder) {
  const Camera& c = shot.camera;
  const auto scene = folder / "scene.pov", picture = folder / "pov.ppm";
  std::ofstream out(scene);
  out << "#version 3.7;\nglobal_settings { assumed_gamma 1 max_trace_level 1 }\nbackground { rgb 0 }\n"
      << "camera { orthographic location " << pov_text(c.centre - c.distance * c.forward) << " direction "
      << pov_text(c.forward) << " right " << pov_text(c.mm_per_pixel * shot.width * c.right) << " up "
      << pov_text(c.mm_per_pixel * shot.height * c.up) << " }\n"
      << "light_source { " << pov_text(c.centre - 100 * c.distance * light_direction(c)) << " rgb 1 parallel point_at "
      << pov_text(c.centre) << " }\n"
      << "#declare M = texture { pigment { rgb <0.9,0.7,0.5> } finish { ambient 0.2 diffuse 0.8 } }\n";
  if (blend > 0) out << "blob { threshold 1\n";
  for (const Sphere& s : model.spheres) {
    if (!(s.radius > 0)) continue;
    const double reach = s.radius + blend, part = reach * reach / (reach * reach - s.radius * s.radius);
    out << "sphere { " << pov_text(s.centre) << ", " << reach;
    if (blend > 0) {
      out << ", " << part * part << " }\n";
    } else {
      out << " texture { M } }\n";
    }
  }
  if (blend > 0) out << "texture { M } }\n";
  out.close();
  std::string antialiasing = " -A";
  if (shot.samples > 1) antialiasing = " +A0.1 +AM1 -J +R" + std::to_string(shot.samples);
  const std::string log = output_of("timeout 140 povray +I'" + scene.string() + "' +O'" + picture.string() +
                                    "' +FP8 -D +WT" + std::to_string(kThreads) + " +W" + std::to_string(shot.width) +
                                    " +H" + std::to_string(shot.height) + antialiasing);
  Peer peer;
  if (const auto at = log.find("Trace Time:"); at != log.npos) {
    if (const auto open = log.find('(', at); open != log.npos) peer.seconds = std::atof(log.c_str() + open + 1);
  }
  if (peer.seconds > 0)
    peer.seen = lit(picture, static_cast<std::size_t>(shot.width) * static_cast<std::size_t>(shot.height));
  return peer;
}

// Ours and a peer in turn; medians.
void compare(const char* what, const char* name, const SphereModel& model, const Shot& shot, Style style, int runs,
             const std::function<Peer()>& peer) {
  const RenderOptions options = options_of(shot, style);
  const Subject subject{.model = &model};
  std::vector<double> ours, theirs, ratios, our_work, their_work;
  double differ = 0;
  for (int run = 0; run < runs; ++run) {
    std::vector<Image> image;
    const double own = processor_seconds(RUSAGE_SELF), other_before = processor_seconds(RUSAGE_CHILDREN);
    ours.push_back(bench::seconds([&] { image = render(std::span(&subject, 1), options, kContext); }));
    our_work.push_back(processor_seconds(RUSAGE_SELF) - own);
    const Peer other = peer();
    their_work.push_back(processor_seconds(RUSAGE_CHILDREN) - other_before);
    if (!(other.seconds > 0)) {
      std::printf("%-34s %4d x %4d, %d x %d samples   ours %7.3f s   %s did not finish\n", what, shot.width,
                  shot.height, shot.samples, shot.samples, bench::median(ours), name);
      return;
    }
    theirs.push_back(other.seconds);
    ratios.push_back(other.seconds / ours.back());
    differ = disagreement(image.front(), other.seen);
  }
  std::printf(
      "%-34s %4d x %4d, %d x %d samples   ours %7.3f s   %s %8.3f s   %s/ours %6.1f   processor "
      "%.3f / %.3f s   pixels differ %.3f %%\n",
      what, shot.width, shot.height, shot.samples, shot.samples, bench::median(ours), name, bench::median(theirs), name,
      bench::median(ratios), bench::median(their_work), bench::median(our_work), differ);
  std::fflush(stdout);
}

SphereModel simplified(const SphereModel& model, std::uint32_t k) {
  SplittingOptions options;
  options.k = k;
  SphereModel simple;
  simple.spheres = spheres_at(split_spheres(model, options, kContext), k);
  return simple;
}

double median_radius(const SphereModel& model) {
  std::vector<double> radii;
  for (const Sphere& s : model.spheres) radii.push_back(s.radius);
  std::ranges::nth_element(radii, radii.begin() + static_cast<std::ptrdiff_t>(radii.size() / 2));
  return radii[radii.size() / 2];
}

}  // namespace

int main(int argc, char** argv) {
  const int runs = argc > 1 ? std::atoi(argv[1]) : 3;
  const std::filesystem::path file = std::filesystem::path(SPHERULE_SHARED_DATA) / "ch2.nii.gz";
  if (!std::filesystem::exists(file)) {
    std::printf("needs %s\n", file.filename().c_str());
    return 0;
  }
  const SphereModel raw = build_model(read_volume({file}), bench::threshold(60.5), {}, kContext).model;
  const SphereModel few = simplified(raw, 64), many = simplified(raw, 10'000), blob = simplified(raw, 1204);

  std::printf("1920 x 1080 with shadows and sky, 3 x 3 samples, %u threads\n", kThreads);
  rays_per_second(few, runs);
  const double of_many = rays_per_second(many, runs), of_raw = rays_per_second(raw, runs);
  std::printf("raw/10,000: %.2f of the rays a second\n\n", of_raw / of_many);

  const Scratch scratch;
  const auto shot_of = [](const SphereModel& model, int width, int height, int samples) {
    return Shot{width, height, samples, make_camera({}, View::anterior, 0, box_of(model), width, height)};
  };
  for (const auto& [name, model] : {std::pair{"64 spheres", &few}, {"10,000 spheres", &many}, {"raw spheres", &raw}}) {
    for (const int samples : {1, 3}) {
      const Shot shot = shot_of(*model, 1920, 1080, samples);
      compare(name, "Tachyon", *model, shot, Style::spheres, runs,
              [&] { return tachyon(*model, shot, scratch.folder); });
      if (model == &raw) break;
    }
  }
  for (const auto& [name, model] : {std::pair{"64 spheres", &few}, {"10,000 spheres", &many}}) {
    const Shot shot = shot_of(*model, 1920, 1080, 3);
    compare(name, "POV-Ray", *model, shot, Style::spheres, runs,
            [&] { return pov_ray(*model, 0, shot, scratch.folder); });
  }
  const Shot shot = shot_of(blob, 512, 512, 3);
  compare("blob of 1,204 components", "POV-Ray", blob, shot, Style::blobs, runs,
          [&] { return pov_ray(blob, median_radius(blob), shot, scratch.folder); });
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  std::printf("most memory of this program, models and all: %.0f MiB\n", static_cast<double>(usage.ru_maxrss) / 1024);
}
