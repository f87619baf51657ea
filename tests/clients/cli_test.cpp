// SPDX-License-Identifier: GPL-3.0-or-later
//
// The developers' command, run as a process on a phantom that the test writes.
#include <gtest/gtest.h>
#include <pty.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <numbers>
#include <sstream>

#include "core/measure/union.h"
#include "core/read/read.h"
#include "core/render/options.h"
#include "core/render/render.h"
#include "core/write/export.h"
#include "core/write/export_file.h"

namespace spherule {
namespace {

namespace fs = std::filesystem;

struct Outcome {
  int status = -1;
  std::string out;  // standard output and error
  std::map<std::string, std::string> rows;
};

class Command : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::path(testing::TempDir()) / ("spherule_cli_" + std::to_string(getpid()));
    fs::create_directories(folder_);
    // Values fall evenly from the centre: the surface at 100 is a ball of radius 10 mm.
    std::ofstream out(folder_ / "ball.raw", std::ios::binary);
    for (int k = 0; k < 26; ++k)
      for (int j = 0; j < 26; ++j)
        for (int i = 0; i < 26; ++i) {
          const double r = std::hypot(i - 12.5, j - 12.5, k - 12.5);
          out.put(static_cast<char>(std::lround(std::max(0.0, 200 - 10 * r))));
        }
  }
  void TearDown() override { fs::remove_all(folder_); }

  // The words after the command's name; FOLDER/ stands for the test's folder.
  Outcome run(std::string words) const {
    for (std::size_t i; (i = words.find("FOLDER/")) != std::string::npos;) words.replace(i, 7, folder_.string() + "/");
    Outcome outcome;
    FILE* pipe = popen((std::string(SPHERULE_COMMAND) + ' ' + words + " 2>&1").c_str(), "r");
    if (pipe == nullptr) return outcome;
    std::array<char, 4096> buffer;
    for (std::size_t n; (n = fread(buffer.data(), 1, buffer.size(), pipe)) > 0;) outcome.out.append(buffer.data(), n);
    const int status = pclose(pipe);
    outcome.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    std::istringstream lines(outcome.out);
    for (std::string key, value; lines >> key && std::getline(lines >> std::ws, value);) outcome.rows[key] = value;
    return outcome;
  }
  // The same with a terminal as standard error, whose text this gives.
  std::string on_a_terminal(std::string words) const {
    for (std::size_t i; (i = words.find("FOLDER/")) != std::string::npos;) words.replace(i, 7, folder_.string() + "/");
    int terminal = -1;
    const pid_t pid = forkpty(&terminal, nullptr, nullptr, nullptr);
    if (pid == 0) {
      execl("/bin/sh", "sh", "-c", ("exec " SPHERULE_COMMAND " " + words + " > /dev/null").c_str(), nullptr);
      _exit(127);
    }
    std::string out;
    std::array<char, 4096> buffer;
    for (ssize_t n; (n = read(terminal, buffer.data(), buffer.size())) > 0;) {
      out.append(buffer.data(), static_cast<std::size_t>(n));
    }
    close(terminal);
    int status = -1;
    waitpid(pid, &status, 0);
    EXPECT_EQ(status, 0) << out;
    return out;
  }
  std::string bytes(const char* name) const {
    std::ifstream in(folder_ / name, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }

  fs::path folder_;
};

const std::string kBall = " FOLDER/ball.raw --raw 26,26,26,uint8 ";

TEST_F(Command, Info) {
  const Outcome o = run("info --plain FOLDER/ball.raw --raw 26,26,26,uint8,1,2,3,-5,0,0.5");
  ASSERT_EQ(o.status, 0) << o.out;
  EXPECT_EQ(o.rows.at("dims"), "26 26 26");
  EXPECT_EQ(o.rows.at("spacing_mm"), "1 2 3");
  EXPECT_EQ(o.rows.at("origin_mm"), "-5 0 0.5");
  EXPECT_EQ(o.rows.at("type"), "uint8");
  EXPECT_EQ(o.rows.at("format"), "raw");
}

TEST_F(Command, MeasuresTheBall) {
  const Outcome o = run("measures --plain --threshold 100.5" + kBall);
  ASSERT_EQ(o.status, 0) << o.out;
  EXPECT_NEAR(std::stod(o.rows.at("tetrahedra_volume_mm3")), 4.0 / 3 * std::numbers::pi * 1000, 100);
  EXPECT_EQ(o.rows.at("tetrahedra_betti"), "1 0 0");
  EXPECT_EQ(o.rows.at("spheres_betti"), "1 0 0");
  EXPECT_EQ(o.rows.at("marching_cubes_euler_characteristic"), "1");
  EXPECT_EQ(o.rows.at("components"), "1");
  const double exact = 4.0 / 3 * std::numbers::pi * 1000;
  for (const char* of : {"spheres", "tetrahedra", "marching_cubes", "voxels"}) {
    EXPECT_NEAR(std::stod(o.rows.at(std::string(of) + "_volume_mm3")), exact, 0.02 * exact) << of;
  }
  EXPECT_NEAR(std::stod(o.rows.at("thickness_mean_mm")), 20, 0.5);
  EXPECT_NEAR(std::stod(o.rows.at("enclosing_sphere_radius_mm")), 10, 0.2);
  EXPECT_GT(std::stod(o.rows.at("excess_volume_slack_mm3")), 0);
  EXPECT_GT(std::stod(o.rows.at("peak_memory_MiB")), 1);
  EXPECT_TRUE(o.rows.contains("delaunay_time_s"));
}

TEST_F(Command, MeasuresASetOfSpheres) {
  std::ofstream(folder_ / "pair.csv") << "x,y,z,r\n0,0,0,1\n5,0,0,2\n";
  const Outcome o = run("measures --plain FOLDER/pair.csv");
  ASSERT_EQ(o.status, 0) << o.out;
  EXPECT_NEAR(std::stod(o.rows.at("spheres_volume_mm3")), 12 * std::numbers::pi, 1e-9);
  EXPECT_NEAR(std::stod(o.rows.at("spheres_area_mm2")), 20 * std::numbers::pi, 1e-9);
  EXPECT_EQ(o.rows.at("spheres_betti"), "2 0 0");
  EXPECT_EQ(o.rows.at("enclosing_sphere_radius_mm"), "4");
  EXPECT_FALSE(o.rows.contains("tetrahedra_volume_mm3"));
}

TEST_F(Command, SimplifiesABall) {
  const std::string ball = "FOLDER/ball.raw --raw 26,26,26,uint8 --threshold 100 --plain ";
  const Outcome inner = run("simplify " + ball + "--method best,mode=inner,k=4 -o FOLDER/few.csv");
  ASSERT_EQ(inner.status, 0) << inner.out;
  EXPECT_EQ(inner.rows.at("k"), "4");
  EXPECT_EQ(inner.rows.at("never_spills"), "yes");
  EXPECT_GT(std::stod(inner.rows.at("iou")), 0.9);
  EXPECT_TRUE(inner.rows.contains("optimality_gap"));
  const Outcome again = run("simplify FOLDER/few.csv --method prune,volume_share=0.5 --plain");
  ASSERT_EQ(again.status, 0) << again.out;
  EXPECT_EQ(again.rows.at("k"), "1") << "one of them is the ball";
  EXPECT_EQ(run("simplify " + ball + "--method prune,buckets=38,39,bucket_count=40").status, 0);
  EXPECT_EQ(run("simplify " + ball).status, 2);
  EXPECT_EQ(run("simplify " + ball + "--method best,k=0").status, 2);
  EXPECT_EQ(run("simplify " + ball + "--method best,k=4,limit=3").status, 2);
}

TEST_F(Command, RegistersTwoSetsOfSpheres) {
  const auto write = [&](const char* name, const char* text) { std::ofstream(folder_ / name) << text; };
  write("three.csv", "x,y,z,r\n0,0,0,3\n5,0,0,2\n0,4,2,1.5\n");
  // A quarter turn about z, twice as large, elsewhere.
  write("turned.csv", "x,y,z,r\n10,20,30,6\n10,30,30,4\n2,20,34,3\n");
  const Outcome o = run("register FOLDER/turned.csv --fixed FOLDER/three.csv --plain -o FOLDER/found.tfm");
  ASSERT_EQ(o.status, 0) << o.out;
  EXPECT_NEAR(std::stod(o.rows.at("scale")), 0.5, 0.002);
  EXPECT_NEAR(std::stod(o.rows.at("angle_deg")), 90, 0.2);
  EXPECT_GT(std::stod(o.rows.at("dice")), 0.99);
  EXPECT_EQ(o.rows.at("poor"), "no");
  EXPECT_TRUE(bytes("found.tfm").starts_with("#Insight Transform File V1.0\n"));
  EXPECT_EQ(run("register FOLDER/three.csv").status, 2);
  EXPECT_EQ(run("register FOLDER/three.csv --fixed FOLDER/turned.csv -o FOLDER/found.csv").status, 2);
  EXPECT_EQ(run("register FOLDER/three.csv --fixed FOLDER/turned.csv --transform rubber").status, 2);
}

TEST_F(Command, ChecksFindNothing) {
  const Outcome o = run("checks --plain --threshold 100.5 --border open" + kBall);
  ASSERT_EQ(o.status, 0) << o.out;
  EXPECT_EQ(o.rows.at("violations"), "0");
}

TEST_F(Command, PointsExportAndModelAgree) {
  const Outcome points = run("points --plain --threshold 100.5 -o FOLDER/points.csv" + kBall);
  ASSERT_EQ(points.status, 0) << points.out;
  const Outcome model = run("export --plain --threshold 100.5 -o FOLDER/spheres.npy" + kBall);
  ASSERT_EQ(model.status, 0) << model.out;
  EXPECT_EQ(points.rows.at("boundary_points"), model.rows.at("boundary_points"));
  EXPECT_EQ(spheres_from_csv(bytes("points.csv")).size(), std::stoul(points.rows.at("boundary_points")));
  EXPECT_EQ(spheres_from_npy(bytes("spheres.npy")).size(), std::stoul(model.rows.at("spheres")));

  // The spheres come back as a model of their own.
  const Outcome again = run("model --plain FOLDER/spheres.npy");
  ASSERT_EQ(again.status, 0) << again.out;
  EXPECT_EQ(again.rows.at("spheres"), model.rows.at("spheres"));
  EXPECT_FALSE(again.rows.contains("tetrahedra"));
}

TEST_F(Command, RendersAPicture) {
  const Outcome o = run("render --threshold 100.5 --size 64x48 --view h -o FOLDER/ball.png" + kBall);
  ASSERT_EQ(o.status, 0) << o.out;
  EXPECT_EQ(bytes("ball.png").substr(0, 8), "\x89PNG\r\n\x1a\n");
}

// Every option that a picture of the REST interface has, by its name with dashes for underscores.
TEST_F(Command, PicturesHaveTheOptionsOfTheInterface) {
  std::ofstream(folder_ / "few.csv") << "x,y,z,r\n0,0,0,3\n5,0,0,2\n0,4,2,1.5\n";
  SphereModel model;
  model.spheres = spheres_from_csv(bytes("few.csv"));
  const OptionTexts given{{"style", "blobs"},      {"smoothness", "0.25"},  {"views", "a,l"},
                          {"width", "64"},         {"height", "48"},        {"background", "gradient"},
                          {"colour_by", "radius"}, {"colour_range", "1,3"}, {"projection", "perspective"},
                          {"scale_bar", "true"},   {"shadows", "false"},    {"field_of_view", "40"}};
  std::string words;
  for (const auto& [name, value] : given) words += " --" + name + ' ' + value;
  std::ranges::replace(words, '_', '-');
  const Outcome o = run("render FOLDER/few.csv -o FOLDER/few.png" + words);
  ASSERT_EQ(o.status, 0) << o.out;
  EXPECT_EQ(bytes("few.png"), encode_png(render(std::array{Subject{&model}}, parse_render_options(given)).front()));
  const Outcome turning = run("render FOLDER/few.csv -o FOLDER/few.gif --size 32 --turntable 3");
  ASSERT_EQ(turning.status, 0) << turning.out;
  EXPECT_EQ(bytes("few.gif").substr(0, 6), "GIF89a");
  const Outcome surface = run("render --threshold 100.5 --style surface --size 32 -o FOLDER/ball.png" + kBall);
  ASSERT_EQ(surface.status, 0) << surface.out;
  EXPECT_EQ(bytes("ball.png").substr(0, 4), "\x89PNG");
}

TEST_F(Command, RangesLabelsAndSides) {
  for (const char* rule : {"--range 50,100", "--labels 100,99,100", "--threshold 100 --below"}) {
    const Outcome o = run("points --plain " + std::string(rule) + kBall);
    ASSERT_EQ(o.status, 0) << o.out;
    EXPECT_NE(o.rows.at("boundary_points"), "0") << rule;
  }
}

TEST_F(Command, UnusableDataIsOneSentenceAndOne) {
  std::ofstream(folder_ / "bad.csv") << "x,y,z,r\n1,2,3,nan\n";
  for (const char* words :
       {"model --threshold 100 FOLDER/absent.nii", "model --threshold 100 --raw 27,26,26,uint8 FOLDER/ball.raw",
        "model --threshold 300 --raw 26,26,26,uint8 FOLDER/ball.raw", "model FOLDER/bad.csv", "info FOLDER/ball.raw"}) {
    const Outcome o = run(words);
    EXPECT_EQ(o.status, 1) << words << '\n' << o.out;
    EXPECT_TRUE(o.out.starts_with("spherule: ") && o.out.ends_with(".\n")) << o.out;
    EXPECT_EQ(std::ranges::count(o.out, '\n'), 1) << o.out;
    EXPECT_EQ(o.out.find(folder_.string()), std::string::npos) << "a path is said: " << o.out;
  }
}

TEST_F(Command, AFolderIsNoFile) {
  fs::create_directories(folder_ / "spheres.csv");
  fs::create_directories(folder_ / "scan.nii");
  for (const char* words : {"model FOLDER/spheres.csv", "measures FOLDER/spheres.csv", "info FOLDER/scan.nii",
                            "model --threshold 1 FOLDER/scan.nii", "info FOLDER/absent.nii"}) {
    const Outcome o = run(words);
    EXPECT_EQ(o.status, 1) << words << '\n' << o.out;
    EXPECT_EQ(std::ranges::count(o.out, '\n'), 1) << o.out;
    EXPECT_EQ(o.out.find("send"), std::string::npos) << "nothing is sent here: " << o.out;
    EXPECT_EQ(o.out.find("defect"), std::string::npos) << o.out;
  }
}

// What makes no sense, or cannot end well, is said before any work: here before the input is found to be no volume.
TEST_F(Command, OptionsAreCheckedBeforeTheWork) {
  std::ofstream(folder_ / "letter.nii") << "this is a letter, not a scan";
  std::ofstream(folder_ / "few.csv") << "x,y,z,r\n0,0,0,1\n";
  EXPECT_EQ(run("info FOLDER/letter.nii").status, 1);
  for (const char* words : {"model FOLDER/letter.nii",
                            "points FOLDER/letter.nii",
                            "checks FOLDER/letter.nii",
                            "simplify FOLDER/letter.nii",
                            "simplify --threshold 1 FOLDER/letter.nii",
                            "simplify --threshold 1 --method best,k=0 FOLDER/letter.nii",
                            "simplify --threshold 1 --method best,iou=2 FOLDER/letter.nii",
                            "simplify --threshold 1 --method sphericity,threshold=7 FOLDER/letter.nii",
                            "model --range 2,1 FOLDER/letter.nii",
                            "model --range 1,inf FOLDER/letter.nii",
                            "model --threshold nan FOLDER/letter.nii",
                            "model --threshold 1 FOLDER/few.csv",
                            "model --threshold 1 --file density=2 FOLDER/letter.nii",
                            "model --threshold 1 --file density=-2 -o FOLDER/a.urdf FOLDER/letter.nii",
                            "model --threshold 1 --file detail=2 -o FOLDER/a.urdf FOLDER/letter.nii",
                            "render --threshold 1 --size 0 -o FOLDER/a.png FOLDER/letter.nii",
                            "render --threshold 1 --samples 99 -o FOLDER/a.png FOLDER/letter.nii",
                            "render --threshold 1 --style cubes -o FOLDER/a.png FOLDER/letter.nii",
                            "render --threshold 1 --smoothness 2 -o FOLDER/a.png FOLDER/letter.nii",
                            "render --threshold 1 --view a --views a,l -o FOLDER/a.png FOLDER/letter.nii",
                            "render --threshold 1 --turntable 8 -o FOLDER/a.png FOLDER/letter.nii",
                            "render --threshold 1 -o FOLDER/a.gif FOLDER/letter.nii",
                            "render --threshold 1 --size 9 --width 9 -o FOLDER/a.png FOLDER/letter.nii",
                            "render --threshold 1 --position 1,2,3 --look-at 1,2,3 -o FOLDER/a.png FOLDER/letter.nii",
                            "render --style surface -o FOLDER/a.png FOLDER/few.csv",
                            "register --threshold 1 FOLDER/letter.nii",
                            "register FOLDER/letter.nii --fixed FOLDER/few.csv",
                            "register FOLDER/few.csv --fixed FOLDER/few.csv --threshold 1"}) {
    const Outcome o = run(words);
    EXPECT_EQ(o.status, 2) << words << '\n' << o.out;
  }
  for (const char* words : {"model --threshold 1 -o FOLDER/absent/a.csv FOLDER/letter.nii",
                            "render --threshold 1 -o FOLDER/absent/a.png FOLDER/letter.nii",
                            "model FOLDER/few.csv -o FOLDER/mask.nii.gz"}) {
    const Outcome o = run(words);
    EXPECT_EQ(o.status, 1) << words << '\n' << o.out;
    EXPECT_TRUE(o.out.find("output file") != std::string::npos || o.out.find("grid") != std::string::npos) << o.out;
  }
}

TEST_F(Command, FindsTheDataBesideAHeader) {
  std::ofstream(folder_ / "ball.mhd") << "ObjectType = Image\nNDims = 3\nDimSize = 26 26 26\n"
                                         "ElementType = MET_UCHAR\nElementDataFile = ball.raw\n";
  std::ofstream(folder_ / "ball.nhdr") << "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 26 26 26\nencoding: raw\n"
                                          "spacings: 1 1 1\ndata file: ball.raw\n";
  for (const char* header : {"ball.mhd", "ball.nhdr"}) {
    const Outcome o = run("info --plain FOLDER/" + std::string(header));
    ASSERT_EQ(o.status, 0) << header << o.out;
    EXPECT_EQ(o.rows.at("dims"), "26 26 26");
    EXPECT_EQ(o.rows.at("max"), "191");
  }
}

// Percentages of each stage as a terminal sees them: they rise, and none comes back.
TEST_F(Command, ProgressNeverGoesBackOnATerminal) {
  constexpr int n = 96;
  std::ofstream out(folder_ / "large.raw", std::ios::binary);
  std::string bytes;
  for (int k = 0; k < n; ++k)
    for (int j = 0; j < n; ++j)
      for (int i = 0; i < n; ++i)
        bytes += static_cast<char>(std::lround(std::max(0.0, 200 - 3 * std::hypot(i - 47.5, j - 47.5, k - 47.5))));
  out << bytes;
  out.close();
  const std::string volume = " FOLDER/large.raw --raw 96,96,96,uint8";
  for (const char* words : {"model --range 100,150", "model --threshold 100"}) {
    std::istringstream text(on_a_terminal(words + volume));
    std::map<std::string, int> reached;
    std::string now;
    for (std::string line; std::getline(text, line, '\r');) {
      if (!line.ends_with(" %")) continue;
      const std::size_t start = line.find('K'), space = line.rfind(' ', line.size() - 3);
      const std::string stage = line.substr(start + 1, space - start - 1);
      const int percent = std::stoi(line.substr(space + 1));
      if (stage != now) {
        EXPECT_FALSE(reached.contains(stage) && percent <= reached.at(stage)) << words << ": " << line;
        now = stage;
      }
      EXPECT_GT(percent, reached.try_emplace(stage, -1).first->second) << words << ": " << line;
      reached[stage] = percent;
    }
    EXPECT_FALSE(reached.empty()) << words;
  }
}

TEST_F(Command, ExportWritesEveryFileThatAServerDoes) {
  const Outcome few = run("simplify --plain --threshold 100.5 --method best,k=3 -o FOLDER/few.csv" + kBall);
  ASSERT_EQ(few.status, 0) << few.out;
  const auto spheres = spheres_from_csv(bytes("few.csv"));
  const UnionMeasures whole = measure_union(spheres);
  for (std::size_t f = 0; f < file_format_count; ++f) {
    const auto format = static_cast<FileFormat>(f);
    const std::string ending(info(format).extension);
    const std::string grid = format == FileFormat::nifti ? " --file voxel_mm=0.5" : "";
    const Outcome o = run("export FOLDER/few.csv -o FOLDER/few." + ending + grid);
    ASSERT_EQ(o.status, 0) << ending << o.out;
    const FileOptions options{.voxel_mm = grid.empty() ? std::optional<double>() : 0.5};
    EXPECT_EQ(bytes(("few." + ending).c_str()), spheres_to_file(format, {.spheres = spheres, .whole = &whole}, options))
        << ending;
  }
  const Outcome mask = run("simplify --threshold 100.5 --method best,k=3 -o FOLDER/mask.nii.gz" + kBall);
  ASSERT_EQ(mask.status, 0) << mask.out;
  EXPECT_EQ(read_volume({folder_ / "mask.nii.gz"}, {}).grid.dims, (std::array<std::int32_t, 3>{26, 26, 26}));
  const Outcome heavy = run("export FOLDER/few.csv -o FOLDER/few.urdf --file density=2500,link=ball");
  ASSERT_EQ(heavy.status, 0) << heavy.out;
  EXPECT_NE(bytes("few.urdf").find("\"ball\""), std::string::npos);
}

TEST_F(Command, SenselessWordsAreOneSentenceAndTwo) {
  for (const char* words : {"",
                            "paint FOLDER/ball.raw",
                            "info",
                            "info --colour red FOLDER/ball.raw",
                            "info --threshold",
                            "model FOLDER/ball.raw --raw 26,26,26,uint8",
                            "model --threshold x FOLDER/ball.raw",
                            "model --threshold 1 --range 1,2 FOLDER/ball.raw",
                            "model --range 1 FOLDER/ball.raw",
                            "model --range 2,1 FOLDER/ball.raw --raw 26,26,26,uint8",
                            "info --raw 26,26,uint8 FOLDER/ball.raw",
                            "info --raw 26,26,26,int128 FOLDER/ball.raw",
                            "render --threshold 1 FOLDER/ball.raw",
                            "render --threshold 1 -o FOLDER/a.gif FOLDER/ball.raw",
                            "export --threshold 1 -o FOLDER/a.stl FOLDER/ball.raw",
                            "measures --threshold 1 -o FOLDER/a.csv FOLDER/ball.raw",
                            "info --threads 0 FOLDER/ball.raw",
                            "export --file detail=9 -o FOLDER/a.glb FOLDER/a.csv",
                            "export --file voxel -o FOLDER/a.vdb FOLDER/a.csv",
                            "export --file density=1 -o FOLDER/a.csv FOLDER/a.npy",
                            "points --threshold 1 -o FOLDER/a.urdf FOLDER/ball.raw",
                            "render --view x -o FOLDER/a.png FOLDER/ball.raw",
                            "info --border ajar FOLDER/ball.raw",
                            "points --border ajar --threshold 1 FOLDER/ball.raw",
                            "info --plain=maybe FOLDER/ball.raw",
                            "info --frame 0x1 FOLDER/ball.raw",
                            "info --frame 1 --frame 1 FOLDER/ball.raw",
                            "info -x FOLDER/ball.raw",
                            "--plain info FOLDER/ball.raw",
                            "--threshold"}) {
    const Outcome o = run(words);
    EXPECT_EQ(o.status, 2) << words << '\n' << o.out;
    EXPECT_TRUE(o.out.starts_with("spherule: ")) << o.out;
    EXPECT_EQ(std::ranges::count(o.out, '\n'), 1) << o.out;
  }
}

TEST_F(Command, SenselessWordsSayWhatIsWrong) {
  EXPECT_EQ(run("info --colour red FOLDER/ball.raw").out,
            "spherule: The command info has no option --colour; see spherule info --help.\n");
  EXPECT_EQ(run("points FOLDER/ball.raw --threshold").out, "spherule: --threshold needs a value.\n");
  EXPECT_EQ(run("info --frame 1 --frame 2 FOLDER/ball.raw").out, "spherule: Give --frame once.\n");
  EXPECT_EQ(run("paint FOLDER/ball.raw").out, "spherule: There is no command \"paint\"; see spherule --help.\n");
  EXPECT_EQ(run("info").out, "spherule: Name a file: spherule info FILE....\n");
}

// A value may begin with a dash; a file may be called as a command is.
TEST_F(Command, ValuesAreTakenAsTheyAre) {
  fs::copy_file(folder_ / "ball.raw", folder_ / "info");
  const Outcome o = run("points --plain --range -5,100 --raw 26,26,26,uint8 FOLDER/info");
  ASSERT_EQ(o.status, 0) << o.out;
  const std::string in_folder = "cd " + folder_.string() + " && " SPHERULE_COMMAND " info info --raw=26,26,26,uint8";
  EXPECT_EQ(std::system((in_folder + " > listing 2>&1").c_str()), 0) << bytes("listing");
}

TEST_F(Command, HelpNamesEveryCommand) {
  const Outcome o = run("--help");
  ASSERT_EQ(o.status, 0);
  for (const char* word :
       {"info", "points", "model", "simplify", "register", "measures", "checks", "render", "export"}) {
    EXPECT_NE(o.out.find(std::string("\n  ") + word + ' '), std::string::npos) << word;
    const Outcome own = run(std::string(word) + " --help");
    EXPECT_EQ(own.status, 0);
    EXPECT_NE(own.out.find(std::string("Usage: spherule ") + word + " FILE"), std::string::npos) << own.out;
    EXPECT_NE(own.out.find("\n  --threads N "), std::string::npos) << own.out;
  }
}

TEST_F(Command, HelpTellsEveryOptionOfAPicture) {
  const Outcome o = run("render --help");
  for (const std::string_view name : render_option_names()) {
    if (name == "layout") continue;  // of two models
    std::string option = "\n  --" + std::string(name) + ' ';
    std::ranges::replace(option, '_', '-');
    const std::size_t at = o.out.find(option);
    ASSERT_NE(at, std::string::npos) << name;
    std::istringstream rest(o.out.substr(at + option.size()));
    std::string value, told;
    rest >> value >> told;
    EXPECT_NE(value, "VALUE") << name;
    EXPECT_FALSE(told.starts_with("--")) << name;
  }
}

}  // namespace
}  // namespace spherule
