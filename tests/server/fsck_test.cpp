// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/fsck.h"

#include <gtest/gtest.h>
#include <sqlite3.h>

#include <algorithm>
#include <fstream>
#include <map>
#include <set>

#include "api/json/records.h"
#include "server/base/digest.h"
#include "server/records/catalog.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

namespace fs = std::filesystem;
using test::error_of;
using Kind = Finding::Kind;

/// A data folder with two volumes, a model of each, and an answer from both models; each with one blob.
class Store : public testing::Test {
 protected:
  test::TemporaryFolder folder;
  fs::path data = folder.path() / "data";
  std::map<std::string, fs::path> blob;  // of each id

  static std::string record_of(const std::string& collection, const std::string& id) {
    api::VolumeInfo volume;
    api::ModelInfo model;
    volume.id = model.id = id;
    if (collection == "volumes") return api::record_of(volume);
    return collection == "models" ? api::record_of(model) : std::string();
  }

  void run_sql(const std::string& sql) const {
    sqlite3* database = nullptr;
    ASSERT_EQ(sqlite3_open((data / "catalog.sqlite").c_str(), &database), SQLITE_OK);
    EXPECT_EQ(sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr), SQLITE_OK) << sqlite3_errmsg(database);
    sqlite3_close(database);
  }

  void SetUp() override {
    Catalog catalog(data / "catalog.sqlite");
    FileBlobStore blobs(data / "blobs");
    const auto add = [&](const std::string& id, const std::string& collection, const std::vector<std::string>& inputs) {
      Resource resource;
      resource.id = id;
      resource.collection = collection;
      resource.inputs = inputs;
      resource.bytes = 1000;
      resource.blobs = {blobs.put(collection + "/" + id, std::string(1000, id.back()))};
      resource.document = record_of(collection, id);
      ASSERT_TRUE(publish(catalog, blobs, resource));
      blob[id] = data / "blobs" / resource.blobs[0];
    };
    add("vol_1", "volumes", {});
    add("vol_2", "volumes", {});
    add("mdl_1", "models", {"vol_1"});
    add("mdl_2", "models", {"vol_2"});
    add("ans_1", "answers", {"mdl_1", "mdl_2"});
    JobRecord job;
    job.id = "job_1";
    job.kind = "model";
    catalog.add_job(job);
  }

  static std::multiset<std::string> findings(const StoreReport& report) {
    std::multiset<std::string> all;
    for (const Finding& finding : report.findings)
      all.insert(std::string(to_string(finding.kind)) +
                 (finding.kind == Kind::unowned_blob || finding.kind == Kind::lost_row ? "" : ": " + finding.what));
    return all;
  }

  std::set<std::string> ids() const {
    std::set<std::string> all;
    for (const Resource& resource : Catalog(data / "catalog.sqlite").list_all("", 1000).items) all.insert(resource.id);
    return all;
  }

  static void damage(const fs::path& file, std::streamoff at, const std::string& bytes = "?") {
    std::fstream stream(file, std::ios::in | std::ios::out | std::ios::binary);
    stream.seekp(at);
    stream << bytes;
  }

  std::size_t set_aside() const {
    return fs::exists(data / "damaged") ? static_cast<std::size_t>(std::distance(
                                              fs::directory_iterator(data / "damaged"), fs::directory_iterator()))
                                        : 0;
  }
};

TEST_F(Store, ThatIsSoundHasNoFindings) {
  for (const bool repair : {false, true}) {
    const StoreReport report = check_store(data, repair);
    EXPECT_TRUE(report.findings.empty());
    EXPECT_EQ(report.resources, 5U);
    EXPECT_EQ(report.blobs, 5U);
    EXPECT_EQ(report.bytes, 5000U);
  }
  EXPECT_EQ(ids().size(), 5U);
  EXPECT_EQ(set_aside(), 0U);
}

TEST_F(Store, IsNotCheckedUnderARunningServer) {
  const Catalog server(data / "catalog.sqlite");
  EXPECT_EQ(error_of([&] { (void)check_store(data, false); }), ErrorCode::busy);
  EXPECT_EQ(error_of([&] { (void)check_store(folder.path(), false); }), ErrorCode::not_found);
  EXPECT_FALSE(fs::exists(folder.path() / "catalog.sqlite")) << "asking makes nothing";
}

TEST_F(Store, MissingDamagedAndUnownedBlobsAreFound) {
  fs::remove(blob["ans_1"]);
  damage(blob["mdl_2"], 500);
  (void)FileBlobStore(data / "blobs").put("volumes/x", "nobody's");
  const std::multiset<std::string> expected = {"a blob is missing: ans_1", "a blob is damaged: mdl_2",
                                               "nothing owns this blob"};
  EXPECT_EQ(findings(check_store(data, false)), expected);
  EXPECT_EQ(ids().size(), 5U) << "looking changes nothing";
  EXPECT_EQ(check_store(data, false).resources, 3U);

  const StoreReport repaired = check_store(data, true);
  EXPECT_EQ(findings(repaired), expected);
  EXPECT_EQ(repaired.resources, 3U);
  EXPECT_EQ(ids(), (std::set<std::string>{"mdl_1", "vol_1", "vol_2"}));
  EXPECT_EQ(set_aside(), 2U) << "the damaged blob and the unowned one";
  EXPECT_TRUE(check_store(data, false).findings.empty());
}

TEST_F(Store, ADamagedVolumeTakesAlongWhatWasMadeFromIt) {
  fs::resize_file(blob["vol_1"], 999);
  const StoreReport repaired = check_store(data, true);
  EXPECT_EQ(findings(repaired), (std::multiset<std::string>{"a blob is damaged: vol_1"}));
  EXPECT_EQ(ids(), (std::set<std::string>{"mdl_2", "vol_2"}));
  EXPECT_EQ(set_aside(), 3U) << "nothing is deleted";
}

TEST_F(Store, DamagedRecordsAreFoundAndSetAside) {
  run_sql("UPDATE resources SET document = replace(document, '\"spheres\":0', '\"spheres\":null') WHERE id = 'mdl_1'");
  run_sql("UPDATE resources SET document = 'x' WHERE id = 'vol_2'");
  run_sql("UPDATE resources SET created = 9223372036854775807 WHERE id = 'mdl_2'");
  run_sql("UPDATE jobs SET state = 'dreaming'");
  const std::multiset<std::string> expected = {"a record is damaged: mdl_1", "a record is damaged: mdl_2",
                                               "a record is damaged: vol_2", "a job's record is damaged: job_1"};
  EXPECT_EQ(findings(check_store(data, false)), expected);
  EXPECT_EQ(ids().size(), 4U) << "all that can be listed is still there";
  EXPECT_EQ(findings(check_store(data, true)), expected);
  EXPECT_EQ(ids(), std::set<std::string>{"vol_1"});
  EXPECT_TRUE(fs::exists(data / "damaged" / "mdl_1.record"));
  EXPECT_TRUE(check_store(data, false).findings.empty());
}

TEST_F(Store, DamagedUploadsAndRepliesAreFoundAndSetAside) {
  const auto write = [&](const std::string& name, const std::string& text) {
    fs::create_directories((data / name).parent_path());
    std::ofstream(data / name) << text;
  };
  write("uploads/upl_1.info", "10\nname\n5\n");
  write("uploads/upl_1.part", "0123");
  write("uploads/upl_2.info", "10\nna");
  write("uploads/upl_2.part", "0123");
  write("replies/a", sha256_hex("reply") + "\nreply");
  write("replies/b", sha256_hex("reply") + "\nrepl");
  const std::multiset<std::string> expected = {"a file is damaged: uploads/upl_2.info", "a file is damaged: replies/b"};
  EXPECT_EQ(findings(check_store(data, false)), expected);
  EXPECT_TRUE(fs::exists(data / "replies" / "b"));
  EXPECT_EQ(findings(check_store(data, true)), expected);
  EXPECT_TRUE(fs::exists(data / "uploads" / "upl_1.part"));
  for (const char* name : {"uploads_upl_2.info", "uploads_upl_2.part", "replies_b"})
    EXPECT_TRUE(fs::exists(data / "damaged" / name)) << name;
  EXPECT_TRUE(check_store(data, false).findings.empty());
}

TEST_F(Store, ThatLostItsCatalogueIsSetAsideAndComesBack) {
  fs::rename(data / "catalog.sqlite", folder.path() / "kept");
  EXPECT_EQ(findings(check_store(data, false)), std::multiset<std::string>{"the catalogue is missing: "});
  EXPECT_FALSE(fs::exists(data / "catalog.sqlite")) << "looking changes nothing";
  EXPECT_EQ(check_store(data, true).resources, 0U);
  EXPECT_EQ(set_aside(), 5U) << "nothing is deleted";
  EXPECT_TRUE(check_store(data, false).findings.empty());

  // The right catalogue is found.
  fs::rename(folder.path() / "kept", data / "catalog.sqlite");
  damage(data / "damaged" / blob["mdl_2"].lexically_relative(data / "blobs").generic_string().replace(6, 1, "_"), 5);
  EXPECT_EQ(check_store(data, false).findings.size(), 5U);
  const std::multiset<std::string> back = findings(check_store(data, true));
  EXPECT_EQ(back.count("a blob was brought back from damaged/: vol_1"), 1U);
  EXPECT_EQ(back.count("a blob is missing: mdl_2"), 1U) << "only what is whole";
  EXPECT_EQ(ids(), (std::set<std::string>{"mdl_1", "vol_1", "vol_2"}));
  EXPECT_TRUE(check_store(data, false).findings.empty());
}

// Many rows over many pages, one of which is overwritten. What is repaired opens, passes SQLite's full check, and keeps
// the rows of all other pages (the inputs' have some 200 short rows each), unless it was a table's root.
TEST_F(Store, ADamagedPageCostsItsOwnRowsOnly) {
  const fs::path file = data / "catalog.sqlite";
  constexpr std::size_t many = 400;
  {
    Catalog catalog(file);
    for (std::size_t i = 0; i < many; ++i) {
      Resource resource;
      resource.id = "ans_many_" + std::to_string(i);
      resource.collection = "answers";
      resource.inputs = {"mdl_1"};
      resource.document = std::string(200, 'd');
      catalog.add(resource);
    }
  }
  const fs::path sound = folder.path() / "sound.sqlite";
  fs::copy_file(file, sound);
  constexpr std::streamoff page = 4096;
  const auto pages = static_cast<std::streamoff>(fs::file_size(file)) / page;
  ASSERT_GT(pages, 20);
  int found = 0, repaired = 0, roots = 0;
  for (std::streamoff number = 1; number < pages; number += pages / 7) {
    fs::copy_file(sound, file, fs::copy_options::overwrite_existing);
    damage(file, number * page, std::string(page, '\xa5'));
    const StoreReport before = check_store(data, false);
    if (before.findings.empty()) continue;  // an unused page
    ++found;
    EXPECT_EQ(before.findings[0].kind, Kind::damaged_catalogue);
    try {
      (void)check_store(data, true);
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::corrupt) << "beyond reading";
      continue;
    }
    ++repaired;
    const StoreReport after = check_store(data, false);
    EXPECT_TRUE(after.findings.empty()) << "page " << number;
    roots += after.resources + 250 < many;
    // Blobs whose rows were lost are set aside, not deleted; bring them back for the next page.
    for (const auto& [id, path] : blob) {
      std::string name = path.lexically_relative(data / "blobs").generic_string();
      std::ranges::replace(name, '/', '_');
      if (!fs::exists(path)) {
        EXPECT_TRUE(fs::exists(data / "damaged" / name)) << name;
        fs::rename(data / "damaged" / name, path);
      }
    }
    fs::remove_all(data / "damaged");
  }
  EXPECT_GT(found, 4);
  EXPECT_GT(repaired, found / 2);
  EXPECT_LT(roots, found / 2);
}

TEST_F(Store, ACatalogueWithoutASchemaIsLeftToABackup) {
  damage(data / "catalog.sqlite", 0, std::string(4096, 'x'));
  EXPECT_EQ(check_store(data, false).findings.size(), 1U);
  EXPECT_EQ(error_of([&] { (void)check_store(data, true); }), ErrorCode::corrupt);
  EXPECT_TRUE(fs::exists(data / "catalog.sqlite"));
}

TEST_F(Store, IsCopiedWhileAServerUsesIt) {
  const fs::path copy = folder.path() / "backup";
  {
    Catalog server(data / "catalog.sqlite");
    FileBlobStore blobs(data / "blobs");
    const StoreReport report = copy_store(data, copy);
    EXPECT_TRUE(report.findings.empty());
    EXPECT_EQ(report.resources, 5U);
    withdraw(server, blobs, "vol_1");
    EXPECT_EQ(error_of([&] { (void)copy_store(data, copy); }), ErrorCode::conflict);
  }
  EXPECT_EQ(ids(), (std::set<std::string>{"mdl_2", "vol_2"}));
  EXPECT_EQ(check_store(copy, false).resources, 5U) << "deleting later does not reach the copy";
  EXPECT_FALSE(fs::exists(copy / "catalog.partial"));

  fs::remove_all(data);
  EXPECT_EQ(copy_store(copy, data).resources, 5U);
  EXPECT_EQ(ids().size(), 5U);
  EXPECT_TRUE(Catalog(data / "catalog.sqlite").find_job("job_1"));
  const FileBlobStore restored(data / "blobs");
  for (const Resource& resource : Catalog(data / "catalog.sqlite").list_all("", 10).items)
    EXPECT_EQ(restored.read(resource.blobs[0]), std::string(1000, resource.id.back()));
}

TEST_F(Store, ACopyLeavesOutWhatIsDamaged) {
  damage(blob["mdl_1"], 0);
  fs::remove(blob["vol_2"]);
  const StoreReport report = copy_store(data, folder.path() / "backup");
  EXPECT_EQ(findings(report), (std::multiset<std::string>{"a blob is damaged: mdl_1", "a blob is missing: vol_2"}));
  EXPECT_EQ(report.resources, 1U);
  EXPECT_EQ(ids().size(), 5U) << "the original is as it was";
  EXPECT_EQ(error_of([&] { (void)copy_store(folder.path() / "none", folder.path() / "c"); }), ErrorCode::not_found);
}

}  // namespace
}  // namespace spherule::server
