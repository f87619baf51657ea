// SPDX-License-Identifier: GPL-3.0-or-later
//
// Every command with curl that README, docs/ and the contract show, run as it stands there. Only the server's address,
// the scan (a small one takes its place) and placeholders ("vol_…", "mdl_…", "reg_…") are put in.
#include <gtest/gtest.h>

#include <fstream>
#include <sstream>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

namespace fs = std::filesystem;

struct Example {
  std::string where, script;
};

// Runs of equally indented lines with curl in one of them.
std::vector<Example> examples(const fs::path& file) {
  std::ifstream in(file);
  std::vector<Example> found;
  std::string line, block;
  std::size_t indent = 0, number = 0;
  const auto end_block = [&] {
    if (indent >= 4 && block.find("curl ") != std::string::npos) {
      found.push_back({file.filename().string() + " before line " + std::to_string(number), block});
    }
    block.clear();
  };
  while (std::getline(in, line)) {
    ++number;
    const std::size_t start = line.find_first_not_of(' ');
    if (start == std::string::npos || start != indent) end_block();
    if (start == std::string::npos) continue;
    indent = start;
    block += line.substr(start) + "\n";
  }
  end_block();
  return found;
}

std::string replaced(std::string text, const std::string& what, const std::string& by) {
  for (std::size_t at = 0; (at = text.find(what, at)) != std::string::npos; at += by.size()) {
    text.replace(at, what.size(), by);
  }
  return text;
}

void write(const fs::path& file, const std::string& bytes) { std::ofstream(file, std::ios::binary) << bytes; }

TEST(Documentation, ShowsCommandsThatWork) {
  const fs::path root = SPHERULE_SOURCES;
  std::vector<fs::path> files = {root / "README.md", root / "openapi.yaml"};
  for (const auto& entry : fs::recursive_directory_iterator(root / "docs")) {
    if (entry.path().extension() == ".md") files.push_back(entry.path());
  }
  const TemporaryFolder folder;
  const ServerProcess server(folder.path() / "data");
  const Client client(server.port());
  write(folder.path() / "ch2.nii.gz", ball_nifti(24, 11.5, 1));
  write(folder.path() / "ct-head.mhd",
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nDimSize = 24 24 24\n"
        "ElementSpacing = 2 2 2\nElementType = MET_UCHAR\nElementDataFile = ct-head.raw\n");
  write(folder.path() / "ct-head.raw", ball(24, 11.5));
  write(folder.path() / "engine.raw", ball(24, 11.5) + std::string(256 * 256 * 128 - 24 * 24 * 24, '\0'));
  write(folder.path() / "spheres.csv", "x,y,z,r\n0,0,0,1\n1,0,0,1.5\n");
  const std::string volume = client.upload("", ball_nifti(24, 11.5, 1));
  const Answer made = client.post("/v1/models", {.headers = {{"Prefer", "wait=60"}},
                                                 .body = R"({"volume": ")" + volume + R"(", "threshold": 100})"});
  const std::string model(made.header("Location").substr(std::string_view("/v1/models/").size()));
  const Answer registered = client.post(
      "/v1/registrations",
      {.headers = {{"Prefer", "wait=60"}}, .body = R"({"fixed": ")" + model + R"(", "moving": ")" + model + R"("})"});
  const std::string registration(registered.header("Location").substr(std::string_view("/v1/registrations/").size()));

  std::size_t commands = 0;
  for (const fs::path& file : files) {
    for (auto& [where, script] : examples(file)) {
      std::string text = replaced(script, "http://127.0.0.1:8080", "http://127.0.0.1:" + std::to_string(server.port()));
      text = replaced(text, "localhost:8080", "127.0.0.1:" + std::to_string(server.port()));
      text = replaced(text, "/usr/share/mricron/templates/", "");
      text = replaced(replaced(text, "vol_…", volume), "mdl_…", model);
      text = replaced(text, "reg_…", registration);
      write(folder.path() / "example.sh", "set -euo pipefail\ncd '" + folder.path().string() +
                                              "'\ncurl() { command curl --fail-with-body \"$@\"; }\n" + text);
      const std::string command =
          "bash '" + (folder.path() / "example.sh").string() + "' >'" + (folder.path() / "output").string() + "' 2>&1";
      const int status = std::system(command.c_str());
      std::ostringstream output;
      output << std::ifstream(folder.path() / "output").rdbuf();
      EXPECT_EQ(status, 0) << where << ":\n" << text << "\n" << output.str().substr(0, 2000);
      ++commands;
    }
  }
  EXPECT_GE(commands, 4U) << "the examples were not found";
  EXPECT_EQ(fs::exists(folder.path() / "head.png"), true) << "the README's session draws a picture";
}

}  // namespace
}  // namespace spherule::test
