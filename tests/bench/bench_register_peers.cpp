// SPDX-License-Identifier: GPL-3.0-or-later
//
// Registration beside PCL (FPFH, SAC-IA, ICP) and elastix (affine, mutual information) on the same pairs of volumes.
// PCL finds no scale: it is given the one that the volumes suggest, and our points with our normals. elastix, whose
// Debian package has no similarity transform, starts with the centres of gravity laid on each other. Usage:
// bench_register_peers [pairs of each object]
#include <pcl/features/fpfh.h>
#include <pcl/filters/voxel_grid.h>
#include <pcl/registration/ia_ransac.h>
#include <pcl/registration/icp.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>

#include "core/register/register.h"
#include "core/write/write_nifti.h"
#include "tests/bench/registration_pairs.h"

namespace spherule::bench {
namespace {

using Points = pcl::PointCloud<pcl::PointNormal>;

Points::Ptr cloud(const Surface& surface, Vec3 origin, double scale) {
  Points::Ptr points(new Points);
  for (std::size_t i = 0; i < surface.size(); ++i) {
    const Vec3 p = scale * (surface.points[i] - origin), n = surface.normals[i];
    pcl::PointNormal point;
    point.x = static_cast<float>(p.x), point.y = static_cast<float>(p.y), point.z = static_cast<float>(p.z);
    point.normal_x = static_cast<float>(n.x), point.normal_y = static_cast<float>(n.y);
    point.normal_z = static_cast<float>(n.z);
    points->push_back(point);
  }
  return points;
}

Points::Ptr thinned(const Points::Ptr& points, double leaf) {
  Points::Ptr few(new Points);
  pcl::VoxelGrid<pcl::PointNormal> grid;
  grid.setInputCloud(points);
  const auto edge = static_cast<float>(leaf);
  grid.setLeafSize(edge, edge, edge);
  grid.filter(*few);
  return few;
}

pcl::PointCloud<pcl::FPFHSignature33>::Ptr features(const Points::Ptr& points, double radius) {
  pcl::PointCloud<pcl::FPFHSignature33>::Ptr result(new pcl::PointCloud<pcl::FPFHSignature33>);
  pcl::FPFHEstimation<pcl::PointNormal, pcl::PointNormal, pcl::FPFHSignature33> estimation;
  estimation.setInputCloud(points);
  estimation.setInputNormals(points);
  estimation.setRadiusSearch(radius);
  estimation.compute(*result);
  return result;
}

AffineMap by_pcl(const Shape& fixed, const Shape& moving) {
  const double size = fixed.size_mm(), scale = size / moving.size_mm();
  const Points::Ptr target = cloud(fixed.surface, fixed.centroid, 1),
                    source = cloud(moving.surface, moving.centroid, scale);
  const Points::Ptr few_target = thinned(target, size / 20), few_source = thinned(source, size / 20);
  pcl::SampleConsensusInitialAlignment<pcl::PointNormal, pcl::PointNormal, pcl::FPFHSignature33> rough;
  rough.setInputSource(few_source);
  rough.setSourceFeatures(features(few_source, size / 6));
  rough.setInputTarget(few_target);
  rough.setTargetFeatures(features(few_target, size / 6));
  rough.setMinSampleDistance(static_cast<float>(size / 5));
  rough.setMaxCorrespondenceDistance(size / 5);
  rough.setMaximumIterations(1000);
  Points moved;
  rough.align(moved);
  pcl::IterativeClosestPoint<pcl::PointNormal, pcl::PointNormal> fine;
  fine.setInputSource(thinned(source, size / 50));
  fine.setInputTarget(target);
  fine.setMaxCorrespondenceDistance(size / 10);
  fine.setMaximumIterations(100);
  fine.align(moved, rough.getFinalTransformation());
  const Eigen::Matrix4f m = fine.getFinalTransformation();
  AffineMap map;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) map.linear.rows[static_cast<std::size_t>(r)][c] = scale * static_cast<double>(m(r, c));
    map.shift[r] = static_cast<double>(m(r, 3));
  }
  map.shift = map.shift + fixed.centroid - map.linear * moving.centroid;
  return map;
}

// Numbers of a line "(name a b c)" of elastix's parameter file.
std::vector<double> numbers_of(const std::string& text, const std::string& name) {
  std::vector<double> numbers;
  const std::size_t at = text.find("(" + name + " ");
  if (at == text.npos) return numbers;
  std::istringstream rest(text.substr(at + name.size() + 2, text.find(')', at) - at - name.size() - 2));
  for (double value = 0; rest >> value;) numbers.push_back(value);
  return numbers;
}

std::optional<AffineMap> by_elastix(const Volume& fixed, const Volume& moving, const std::filesystem::path& folder) {
  const auto write = [&](const char* name, const std::string& bytes) {
    std::ofstream(folder / name, std::ios::binary) << bytes;
    return (folder / name).string();
  };
  const std::string parameters = write("parameters.txt", R"((FixedInternalImagePixelType "float")
(MovingInternalImagePixelType "float")
(FixedImageDimension 3)
(MovingImageDimension 3)
(UseDirectionCosines "true")
(Registration "MultiResolutionRegistration")
(Interpolator "LinearInterpolator")
(ResampleInterpolator "FinalBSplineInterpolator")
(Resampler "DefaultResampler")
(FixedImagePyramid "FixedRecursiveImagePyramid")
(MovingImagePyramid "MovingRecursiveImagePyramid")
(Optimizer "AdaptiveStochasticGradientDescent")
(Transform "AffineTransform")
(Metric "AdvancedMattesMutualInformation")
(AutomaticScalesEstimation "true")
(AutomaticTransformInitialization "true")
(AutomaticTransformInitializationMethod "CenterOfGravity")
(NumberOfHistogramBins 32)
(NumberOfResolutions 3)
(MaximumNumberOfIterations 300)
(NumberOfSpatialSamples 3000)
(NewSamplesEveryIteration "true")
(ImageSampler "RandomCoordinate")
(DefaultPixelValue 0)
(WriteResultImage "false")
)");
  const std::string command = "elastix -threads 2 -f " + write("fixed.nii", volume_to_nifti(fixed)) + " -m " +
                              write("moving.nii", volume_to_nifti(moving)) + " -p " + parameters + " -out " +
                              folder.string() + " > /dev/null 2>&1";
  if (std::system(command.c_str()) != 0) return std::nullopt;
  std::ostringstream text;
  text << std::ifstream(folder / "TransformParameters.0.txt").rdbuf();
  const auto p = numbers_of(text.str(), "TransformParameters"), c = numbers_of(text.str(), "CenterOfRotationPoint");
  if (p.size() != 12 || c.size() != 3) return std::nullopt;
  // ITK's AffineTransform: the matrix by rows and the shift; of fixed points to moving ones.
  const Mat3 linear{{Vec3{p[0], p[1], p[2]}, Vec3{p[3], p[4], p[5]}, Vec3{p[6], p[7], p[8]}}};
  const Vec3 centre{c[0], c[1], c[2]}, shift{p[9], p[10], p[11]};
  return inverse(AffineMap{linear, centre + shift - linear * centre});
}

struct Tally {
  std::vector<double> degrees, scale, voxels, time;
  std::size_t right = 0;

  void add(const std::optional<AffineMap>& map, const AffineMap& truth, Vec3 centre, double voxel, double took) {
    time.push_back(took);
    if (!map) return;
    degrees.push_back(angle_between(nearest_rotation(truth.linear), nearest_rotation(map->linear)));
    scale.push_back(100 * std::abs(scale_of(*map) / scale_of(truth) - 1));
    voxels.push_back(norm((*map)(centre)-truth(centre)) / voxel);
    right += degrees.back() < 5 && scale.back() < 5 && voxels.back() < 2;
  }
  void print(const char* name) const {
    if (degrees.empty()) return;
    std::printf("  %-28s %3zu/%-3zu  %8.3f deg  %7.3f %%  %7.3f voxels  %7.2f s\n", name, right, time.size(),
                median(degrees), median(scale), median(voxels), median(time));
    std::fflush(stdout);
  }
};

void run(int pairs) {
  const bool elastix = std::system("command -v elastix > /dev/null 2>&1") == 0;
  const auto folder = std::filesystem::temp_directory_path() / "spherule-bench-register";
  std::filesystem::create_directories(folder);
  constexpr int kFine = 58;
  const Context context{.threads = 2, .cancel = {}, .progress = {}};
  struct Setting {
    const char* name;
    double ratio;
    bool near;
  };
  for (const Setting& setting : {Setting{"any pose, 1:1", 1, false},
                                 {"any pose, 2:1", 2, false},
                                 {"within 10 degrees, 5 % of scale, 1:1", 1, true}}) {
    phantoms::Random random(7);
    Tally ours, pcl_tally, elastix_tally;
    for (const Scan& scan : registration_scans()) {
      const RealObject object(scan, SPHERULE_SHARED_DATA);
      const Vec3 size = object.box.max - object.box.min;
      const double voxel = std::max({size.x, size.y, size.z}) / kFine;
      const AffineMap upright{{}, object.box.min};
      const Volume fixed_volume = taken(object, {.to_object = upright, .voxel = voxel, .seed = 7});
      const SphereModel fixed = model_of(object, fixed_volume).model;
      for (int t = 0; t < pairs; ++t) {
        AffineMap pose = random_pose(object, random);
        if (setting.near) {
          const Mat3 turn = rotation((10 * random.unit() * std::numbers::pi / 180) * random_direction(random));
          const Mat3 linear = scaled(0.95 + 0.1 * random.unit(), turn);
          pose = {linear, object.centre - linear * (object.centre - object.box.min)};
        }
        const Volume moving_volume =
            taken(object, {.to_object = pose, .voxel = voxel * setting.ratio, .seed = random.bits()});
        const SphereModel moving = model_of(object, moving_volume).model;
        const AffineMap truth = composed(inverse(upright), pose);
        const Vec3 centre = inverse(pose)(object.centre);
        const auto timed = [&](Tally& tally, auto&& find) {
          std::optional<AffineMap> map;
          const double took = seconds([&] { map = find(); });
          tally.add(map, truth, centre, voxel, took);
        };
        timed(ours, [&] { return std::optional(register_models(fixed, moving, {}, context).moving_to_fixed); });
        timed(pcl_tally, [&] { return std::optional(by_pcl(shape_of(fixed, 64), shape_of(moving, 64))); });
        if (elastix) timed(elastix_tally, [&] { return by_elastix(fixed_volume, moving_volume, folder); });
      }
    }
    std::printf("%s\n", setting.name);
    ours.print("spherule");
    pcl_tally.print("PCL FPFH + SAC-IA + ICP");
    elastix_tally.print("elastix affine, MI");
  }
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace spherule::bench

int main(int argc, char** argv) {
  try {
    spherule::bench::run(argc > 1 ? std::atoi(argv[1]) : 2);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
}
